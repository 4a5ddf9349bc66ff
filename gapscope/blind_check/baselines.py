"""What else could say which effect is there: simple methods that a blind check is compared with."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gapscope.arm.case import load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, extra
from gapscope.arm.root_mean_square import rms
from gapscope.diagnosis.document.wording import Document
from gapscope.effects.catalogue import CATALOGUE, explained
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.setup_faults import FAULTS
from gapscope.model.conditioning import (
    TORQUE_CUTOFF,
    condition,
    position_cutoff,
    torque_scale,
)
from gapscope.model.jacobian import Bodies, LinearisationPoint, columns
from gapscope.model.rows import DecimatedSegments
from gapscope.model.terms import Terms

# What each effect adds to the torque: the columns that a diagnosis has, of effects without a shape.


class Design(NamedTuple):
    """A case as linear regression; every torque over the joint's scale, M rows, n joints.

    Attributes:
        gap: recorded minus nominal torque, flattened, (M n,).
        terms: effect and joint (from 1; 0 for the arm) of each column.
        columns: (M n, K), each of unit length.
        nrmse: torque gap per joint, (n,).
        n_joints: n.
    """

    gap: np.ndarray
    terms: Sequence[tuple[str, int]]
    columns: np.ndarray
    nrmse: np.ndarray
    n_joints: int

    def places(self, effect: str) -> list[int]:
        """Columns of an effect."""
        return [k for k, (name, _) in enumerate(self.terms) if name == effect]


def design(folder: Path) -> Design:
    """The regression of the case in a folder."""
    case = load_case(folder)
    arm, body = case.arm, RigidBody(case.arm)
    nominal, terms = CorrectedArm(arm), Terms(arm.n_joints)
    cutoff = position_cutoff(case.recordings)
    segments = []
    for recording in case.recordings:
        if recording.tau is not None:
            segments += condition(recording, cutoff)
    rows = DecimatedSegments(segments, TORQUE_CUTOFF)
    scale = torque_scale(rows.rows(segment.recorded_torque for segment in segments))
    none = np.zeros(terms.size)
    points = [
        LinearisationPoint.of(nominal, Bodies(body, segment), terms, none)
        for segment in segments
    ]
    torques = np.vstack([_columns(at, rows) for at in points]) / scale[:, None]
    lengths = np.linalg.norm(torques, axis=(0, 1))
    # what is not on one joint has all its coordinates; an effect that moves no torque on these motions has no column
    told = [
        (term, place)
        for term in terms.all
        for place in term.columns[: None if term.joint == 0 else 1]
        if lengths[place] > 1e-9
    ]
    scaled = [torques[:, :, place].ravel() / lengths[place] for _, place in told]
    # nothing limits the nominal arm's torque
    gaps = (at.bodies.segment.recorded_torque - at.torque for at in points)
    gap = rows.rows(s.bridged(x) for s, x in zip(segments, gaps, strict=True)) / scale
    return Design(
        gap=gap.ravel(),
        terms=[(term.effect, term.joint) for term, _ in told],
        columns=np.stack(scaled, axis=1),
        nrmse=rms(gap),
        n_joints=arm.n_joints,
    )


def _columns(at: LinearisationPoint, rows: DecimatedSegments) -> np.ndarray:
    """Torque by theta on the rows of a segment, (M, n, P); of changed links by their masses alone."""
    out = columns(at, rows)
    masses = rows.thin(at.bodies.regressor()[:, :, ::10], at.bodies.segment)
    for effect in at.terms.definitions:
        if effect.scope == "link":
            # the mass of the last link is the payload's
            places = at.terms.block(effect.name)[0, :-1]
            out[:, :, places] = masses[:, :, :-1]
    return out


# Plain methods; each answers with a verdict and effects in the form of ``diagnosis.json``.


NO_GAP = 0.03
"""Torque NRMSE of the worst joint below which there is no gap."""
EXPLAINED = 0.7
"""Share of the gap's squares above which it counts as explained."""
EFFECTIVE = 10
"""Rows that count as one independent observation."""
RIDGE = 1e-2
"""Penalty of ridge regression [1]."""
NAMED = 0.1
"""Share of the gap's length that an effect needs to be named by ridge regression."""
MAX_COLUMNS = 25
"""Columns that forward selection takes at most."""
JOINT_SHARE = 0.2
"""A joint is named if its weight is this share of the largest of its effect."""
EFFECT_SHARE = 0.15
"""Forward selection names an effect if its weight is this share of the largest."""
ANSWERS = (*CATALOGUE, *FAULTS, "no_gap", "unexplained")
"""What chance draws from; the last two name nothing."""


def chance(n_joints: int, rng: np.random.Generator) -> Document:
    """Any effect on any joint, no gap, or unexplained, each as likely."""
    name = ANSWERS[rng.integers(len(ANSWERS))]
    if name in ANSWERS[-2:]:
        return answer(name, [])
    scope = CATALOGUE[name].scope if name in CATALOGUE else FAULTS[name].scope
    joints = [int(rng.integers(n_joints)) + 1] if scope == "joint" else []
    return answer("effects_found", [(name, joints)])


def largest_r2(design: Design) -> Document:
    """The one effect whose columns leave the smallest residual."""
    if design.nrmse.max() < NO_GAP:
        return answer("no_gap", [])
    # each effect by itself, with all of its joints
    shares = {effect: residual_share(design, effect) for effect in _effects(design)}
    best = min(shares, key=lambda effect: shares[effect])
    if shares[best] > 1.0 - EXPLAINED:
        return answer("unexplained", [])
    places = design.places(best)
    weights = np.abs(_fit(design, places))
    return answer("effects_found", [(best, _joints(design, places, weights))])


def forward_bic(design: Design) -> Document:
    """Columns one by one, the best first, as long as Bayes' information criterion falls."""
    chosen: list[int] = []
    total = design.gap @ design.gap
    residual = design.gap
    score = _bic(residual, 0)
    while len(chosen) < MAX_COLUMNS:
        # columns have unit length: the largest product explains most
        gain = np.abs(design.columns.T @ residual)
        gain[chosen] = 0.0
        candidate = [*chosen, gain.argmax()]
        # all chosen are fitted again: a later one may take over from an earlier one
        fitted = design.columns[:, candidate] @ _fit(design, candidate)
        candidate_residual = design.gap - fitted
        candidate_score = _bic(candidate_residual, len(candidate))
        if candidate_score >= score:
            break
        chosen, residual, score = candidate, candidate_residual, candidate_score
    # the gap is small, whatever the criterion finds in it
    if not chosen or design.nrmse.max() < NO_GAP:
        return answer("no_gap", [])
    explained = residual @ residual < (1.0 - EXPLAINED) * total
    verdict = "effects_found" if explained else "unexplained"
    return answer(verdict, _named(design, chosen, np.abs(_fit(design, chosen))))


def _bic(residual: np.ndarray, terms: int) -> float:
    """Bayes' information criterion of a residual (M n,) after a fit of so many columns."""
    count = len(residual) / EFFECTIVE
    mean_square = max(residual @ residual, 1e-300) / len(residual)
    return count * np.log(mean_square) + terms * np.log(count)


def ridge(design: Design) -> Document:
    """All columns at once with a quadratic penalty; effects whose part of the gap is long enough are named."""
    if design.nrmse.max() < NO_GAP:
        return answer("no_gap", [])
    columns, gap = design.columns, design.gap
    # one penalty for all: columns have unit length, and the gap no unit
    normal = columns.T @ columns + RIDGE * np.eye(columns.shape[1])
    weights = np.linalg.solve(normal, columns.T @ gap)
    residual = gap - columns @ weights
    found = []
    for effect in _effects(design):
        places = design.places(effect)
        explained = columns[:, places] @ weights[places]
        part = np.linalg.norm(explained) / np.linalg.norm(gap)
        if part > NAMED:
            joints = _joints(design, places, np.abs(weights[places]))
            found.append((part, effect, joints))
    largest_first = [
        (effect, joints) for _, effect, joints in sorted(found, reverse=True)
    ]
    small = residual @ residual < (1.0 - EXPLAINED) * gap @ gap
    return answer("effects_found" if small and found else "unexplained", largest_first)


def answer(
    verdict: str, effects: Sequence[tuple[str, list[int]]], probability: float = 1.0
) -> Document:
    """A verdict in the form of ``diagnosis.json``, as far as the scorer reads it."""
    return {
        "verdict": verdict,
        "effects": [
            {
                "effect": name,
                "joints": joints,
                "probability": probability,
                "parameters": {},
                "alternatives": [],
            }
            for name, joints in effects
        ],
    }


def _effects(design: Design) -> list[str]:
    return list(dict.fromkeys(effect for effect, _ in design.terms))


def _fit(design: Design, places: list[int]) -> np.ndarray:
    # columns that depend on each other share
    return np.linalg.lstsq(design.columns[:, places], design.gap, rcond=1e-8)[0]


def residual_share(design: Design, effect: str) -> float:
    """Share of the gap's squares that the columns of one effect do not explain; all of no gap."""
    places = design.places(effect)
    residual = design.gap - design.columns[:, places] @ _fit(design, places)
    total = design.gap @ design.gap
    return residual @ residual / total if total > 0 else 1.0


def _joints(design: Design, places: list[int], weights: np.ndarray) -> list[int]:
    """Joints whose weight is at least ``JOINT_SHARE`` of the largest; none for effects on the arm or a link."""
    terms = [design.terms[k] for k in places]
    if 0 in terms[0] or "link_inertia" in terms[0]:
        return []
    pairs = zip(terms, weights >= JOINT_SHARE * weights.max(), strict=True)
    return [joint for (_, joint), enough in pairs if enough]


def _named(
    design: Design, chosen: list[int], weights: np.ndarray
) -> list[tuple[str, list[int]]]:
    """Effects of chosen columns, longest first, without those below ``EFFECT_SHARE`` of the longest."""
    effects = [design.terms[k][0] for k in chosen]
    length: dict[str, float] = {}
    for effect, weight in zip(effects, weights, strict=True):
        # columns have unit length: weights add up as lengths do
        length[effect] = np.hypot(length.get(effect, 0.0), weight)
    least = EFFECT_SHARE * max(length.values())
    long_enough = [effect for effect in length if length[effect] >= least]
    out = []
    for effect in sorted(long_enough, key=lambda effect: -length[effect]):
        own = [i for i, name in enumerate(effects) if name == effect]
        places = [chosen[i] for i in own]
        out.append((effect, _joints(design, places, weights[own])))
    return out


# A classifier of effects from features of the gap: a network with one hidden layer, trained on separate cases.


PENALTY = 1e-2
"""Weight of the squared coefficients beside the mean log-likelihood."""
HIDDEN = 32
"""Hidden units."""
MAX_ITERATIONS = 500
"""Iterations of the fit."""


def features(design: Design) -> np.ndarray:
    """Residual share of each effect alone, its best joint's correlation; size and concentration of the gap."""
    effects = [effect.name for effect in explained() if not effect.fitted.nonlinear]
    # an effect without columns leaves all: its share is 1
    residual = [residual_share(design, effect) for effect in effects]
    # of no gap, no column is a part
    length = np.linalg.norm(design.gap) or 1.0
    along = np.abs(design.columns.T @ design.gap) / length
    best = []
    for effect in effects:
        places = design.places(effect)
        best.append(along[places].max() if places else 0.0)
    # sorted: the features know no joint by its number
    # below rounding there is no gap, and its logarithm would be infinite
    nrmse = np.sort(np.maximum(design.nrmse, np.finfo(float).eps))[::-1]
    spread = nrmse / nrmse.sum()
    entropy = -(spread * np.log(spread)).sum()
    # an arm of one joint has no second
    size = np.log(nrmse[[0, min(1, len(nrmse) - 1), -1]])
    return np.concatenate([residual, best, size, [entropy]])


def classified(network: Any, design: Design) -> Document:
    """The likeliest class as a verdict.

    Args:
        network: as ``train`` gives it.
        design: of the case.
    """
    probability = network.predict_proba(features(design)[None])[0]
    name = str(network.classes_[probability.argmax()])
    if name == "healthy":
        return answer("no_gap", [])
    if name == "unknown":
        return answer("unexplained", [])
    return answer("effects_found", [(name, [])], probability.max())


def train(x: np.ndarray, names: Sequence[str]) -> Any:
    """Standardisation and network of scikit-learn, fitted to features (N, F) and class names (N,) from fixed weights.

    Raises:
        GapscopeError: scikit-learn is not installed, or there is one class alone.
    """
    with extra("learn", "the classifier of --train"):
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.neural_network import MLPClassifier
        from sklearn.pipeline import make_pipeline
        from sklearn.preprocessing import StandardScaler
    if len(set(names)) < 2:
        raise GapscopeError(
            "a classifier cannot be trained on cases of one class alone",
            "give training cases with several effects, or score without --train",
        )
    network = make_pipeline(
        StandardScaler(),
        MLPClassifier(
            hidden_layer_sizes=(HIDDEN,),
            activation="tanh",
            solver="lbfgs",
            # scikit-learn divides the penalty by the number of samples
            alpha=PENALTY * len(x),
            max_iter=MAX_ITERATIONS,
            random_state=0,
        ),
    )
    with warnings.catch_warnings():
        # the penalty, not the end of the search, keeps the network from overfitting
        warnings.simplefilter("ignore", ConvergenceWarning)
        network.fit(x, names)
    return network
