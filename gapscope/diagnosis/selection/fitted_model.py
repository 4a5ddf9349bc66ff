"""What a search found, fitted to folds: values, presliding, and the evidence that weighs it against all else."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.model.fit_data import FitData
from gapscope.diagnosis.model.linearisation import Linearisation
from gapscope.diagnosis.selection.evidence import Evidence, Fit, likeliest_evidence
from gapscope.diagnosis.thresholds import (
    LINEAR_ENOUGH,
    PRESLIDING_GAIN,
    RELINEARISATIONS,
    SEARCH_RATE,
    VISIBLE_EFFECT,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import DryLaw
from gapscope.effects.friction import PRESLIDING_DISTANCES
from gapscope.model.conditioning import Segment, thinned
from gapscope.model.difference import Difference
from gapscope.model.expected import Detectable, detectable
from gapscope.model.terms import Term, Terms

# A set of terms, fitted around its own values.


@dataclass(frozen=True)
class Model:
    """A set of terms, fitted around its own values.

    Attributes:
        linear: the linearisation around the values.
        evidence: the evidence on it, under the errors of the nominal arm that explain the data best.
        fit: the terms and their values.
    """

    linear: Linearisation
    evidence: Evidence
    fit: Fit


def searched_folds(folds: list[list[Segment]]) -> list[list[Segment]]:
    """Segments of each fold as models are fitted to them: decimated to no less than ``SEARCH_RATE``."""
    return [[thinned(s, SEARCH_RATE) for s in fold] for fold in folds]


def nominal_model(
    arm: NominalArm,
    body: RigidBody,
    folds: list[list[Segment]],
    cutoff: float,
    shapes: Mapping[Term, tuple[float, ...]],
) -> Model:
    """The model without any term.

    Args:
        arm, body: the nominal arm and its dynamics.
        folds: segments per fold.
        cutoff: cut-off of the fit's filter [Hz].
        shapes: nonlinear parameters of the terms that have some.
    """
    data = FitData(arm, body, searched_folds(folds), cutoff)
    terms = Terms(arm.n_joints, dict(shapes), arm.coupled_motors)
    linear = Linearisation(data, np.zeros(terms.size), terms)
    mean_squares = [
        fold.total[:, -2, -2] / np.maximum(fold.count, 1e-9)
        for fold in (half.scored for half in linear.folds)
    ]
    evidence = likeliest_evidence(linear, np.array(mean_squares), frozenset())
    return Model(linear, evidence, evidence.fit(frozenset()))


def fitted_about(nominal: Model, values: Mapping[Term, np.ndarray]) -> Model:
    """A model with some terms, less those whose values turn out impossible.

    Linearises around the values until the torque there is what the linearisation says, and weighs the data anew.

    Args:
        nominal: the model without any term.
        values: linear coordinates of the terms to linearise around at first.
    """
    theta = np.zeros_like(nominal.fit.theta)
    for term, value in values.items():
        theta[list(term.columns)] = value
    fit = replace(nominal.fit, terms=frozenset(values), theta=theta)
    model = nominal
    for _ in range(RELINEARISATIONS):
        theta, terms = _expansion_point(fit), fit.terms
        linear = Linearisation(nominal.linear.data, theta, nominal.linear.terms)
        # rows are weighed by what is left of them: first by the model before, then by this one
        for _ in range(2):
            evidence = likeliest_evidence(linear, fit.scored_mse, fit.terms)
            fit = evidence.fit_possible(fit.terms)
        model = Model(linear, evidence, fit)
        if fit.terms == terms and _nearly_linear(model):
            break
    return model


def _nearly_linear(model: Model) -> bool:
    """Whether the torque at the values of a model is what its linearisation says, so that no new one is needed."""
    if any(t.definition.limits for t in model.fit.terms):
        return True
    return bool(model.linear.departure(model.fit.theta).max() < LINEAR_ENOUGH)


def _expansion_point(fit: Fit) -> np.ndarray:
    """Values around which to linearise: saturation is there or not, how much of it is in its shape."""
    theta = fit.theta.copy()
    limiting = [t.columns[0] for t in fit.terms if t.definition.limits]
    theta[limiting] = 1.0
    return theta


# Presliding beside the dry friction that was found: over what distance it builds up after a reversal.
#
# It is no cause of a gap but part of how dry friction acts: sgn v says nothing of a joint that rests or turns round
# slowly, where most of what dry friction leaves lies. The search trusts these samples least and does without; the
# distance of each joint then comes from a grid, with the values as fitted. It has to narrow the gap of all samples, and
# the trusted ones decide: a distance that suits rests alone does harm on motions without any.


def presliding_distances(model: Model) -> np.ndarray:
    """Distance of each joint [rad], (n,); 0 without dry friction found, or where the gap does not fall decisively."""
    arm = model.linear.arm
    at_once = np.zeros(arm.n_joints)
    dry = has_dry_friction(model.fit.terms, len(at_once))
    if not dry.any():
        return at_once
    size = arm.per_radian
    grid = np.array(
        [np.where(dry, d * size, 0.0) for d in (0.0, *PRESLIDING_DISTANCES)]
    )
    squares = np.array([_squared_gap(model, distance) for distance in grid])
    everywhere, trusted = squares[:, 0], squares[:, 1]
    trusted = np.where(everywhere <= everywhere[0], trusted, np.inf)
    best = np.argmin(trusted, axis=0)
    samples = model.evidence.torque.independent.sum(axis=0)
    gain = 0.5 * samples * np.log(trusted[0] / trusted.min(axis=0))
    chosen = grid[best, np.arange(len(best))]
    return np.where(gain > PRESLIDING_GAIN, chosen, 0.0)


def has_dry_friction(terms: Iterable[Term], n_joints: int) -> np.ndarray:
    """Which joints have a term of dry friction of their own, shape (n,)."""
    dry = np.zeros(n_joints, dtype=bool)
    for term in terms:
        if isinstance(term.definition, DryLaw) and term.definition.reach == "joint":
            dry[term.joint - 1] = True
    return dry


def _squared_gap(model: Model, distance: np.ndarray) -> np.ndarray:
    """Squared gap if dry friction builds up over a distance, over all rows and by trust [N^2 m^2], (2, n)."""
    bent = replace(model.linear.arm, presliding=distance)
    effects = model.linear.terms.effects(model.fit.theta, model.fit.terms)
    return model.linear.squared_gap(CorrectedArm(bent, effects))


# What a search found, as all that follows reads it.


EVERYONE = (0,)
"""The group of all recordings."""
LEAST = 700.0
"""Log odds of what nobody has asked for: as good as none, and yet a number [nats]. (numerical)"""


def nameable(found: Difference) -> Iterator[Detectable]:
    """Sizes of further terms at which a search would name them.

    What does not act in proportion to its size, elasticity and backlash, is left out.
    """
    every = detectable(found, *EVERYONE, VISIBLE_EFFECT)
    return (one for one in every if one.term.definition.locally_linear)


@dataclass(frozen=True)
class Selection:
    """Result of a search.

    Attributes:
        scale: normalisation of the torque gap over all folds [N m], (n,).
        fit: the set of terms, fitted at its own linearisation.
        evidence: the evidence that scores it.
        nominal_mse: mean square of the gap per fold and joint without any effect [N^2 m^2], (F, n).
        last_link: the joint that moves the last link, from 1.
        presliding: distance over which the dry friction of a joint builds up, if it has some [rad], (n,).
        competing: log probability of other sets of terms over that of the set found [nats].
        difference: what the search found, beside its values here; ``None`` if nothing was searched.
    """

    scale: np.ndarray
    fit: Fit
    evidence: Evidence
    nominal_mse: np.ndarray
    last_link: int
    presliding: np.ndarray
    competing: Mapping[frozenset[Term], float] = field(default_factory=dict)
    difference: Difference | None = None

    @classmethod
    def of(
        cls,
        model: Model,
        nominal: Model,
        competing: Mapping[frozenset[Term], float],
        difference: Difference | None,
    ) -> Selection:
        """What a model has over the nominal one."""
        data = nominal.linear.data
        return cls(
            data.torque_deviation,
            model.fit,
            model.evidence,
            nominal.fit.held_out_mse,
            data.body.last_link + 1,
            presliding_distances(model),
            competing,
            difference,
        )

    @property
    def further(self) -> Iterator[Detectable]:
        """Sizes of further terms at which they would be named; of another arm than the nominal one none is known."""
        return iter(()) if self.difference is None else nameable(self.difference)

    @property
    def sheet_error(self) -> float:
        """Likeliest error of the bodies of the data sheet, over their own size [1]; 0 if nothing was searched."""
        levels = self.difference.fit.levels if self.difference else {}
        return max(levels, key=lambda error: levels[error].total, default=0.0)

    def log_odds(self, terms: frozenset[Term]) -> float:
        """Log probability of the sets that have one of some terms over that of those that have none [nats]."""
        sides: dict[bool, list[float]] = {True: [-LEAST], False: [-LEAST]}
        for some, value in {self.fit.terms: 0.0, **self.competing}.items():
            sides[not some.isdisjoint(terms)].append(value)
        likeliest = max(sides[True] + sides[False])
        there, none = (
            np.logaddexp.reduce(np.array(sides[side]) - likeliest)
            for side in (True, False)
        )
        return float(there - none)

    def corrected(self, theta: np.ndarray, terms: frozenset[Term]) -> CorrectedArm:
        """The nominal arm with some terms at values theta, (P,), and the presliding of their dry friction."""
        known, arm = self.evidence.terms, self.evidence.linear.arm
        arm = replace(arm, presliding=self.presliding_of(terms))
        return CorrectedArm(arm, known.effects(known.clipped(theta), terms))

    def presliding_of(self, terms: frozenset[Term]) -> np.ndarray:
        """Distance over which the dry friction of some terms builds up [rad], (n,)."""
        dry = has_dry_friction(terms, len(self.presliding))
        return np.where(dry, self.presliding, 0.0)


def by_finding(terms: frozenset[Term]) -> list[frozenset[Term]]:
    """The terms of each finding."""
    names = sorted({t.finding for t in terms})
    return [frozenset(t for t in terms if t.finding == name) for name in names]
