"""Plain methods; each answers with a verdict and effects in the form of ``diagnosis.json``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gapscope.blind_check.baselines.columns import Design
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.setup_faults.fault_catalogue import FAULTS

NO_GAP = 0.03
"""Torque NRMSE of the worst joint below which there is no gap."""
EXPLAINED = 0.7
"""Share of the gap's squares above which it counts as explained."""
EFFECTIVE = 10
"""Rows that count as one independent observation."""
NAMED = 0.1
"""Share of the gap's length that an effect needs to be named by ridge regression."""
MOST_COLUMNS = 25
"""Columns that forward selection takes at most."""
JOINT_SHARE = 0.2
"""A joint is named if its weight is this share of the largest of its effect."""
EFFECT_SHARE = 0.15
"""Forward selection names an effect if its weight is this share of the largest."""
NAMES = (*CATALOGUE, *FAULTS)
"""What chance draws from."""


def chance(n_joints: int, rng: np.random.Generator) -> dict[str, Any]:
    """Any effect on any joint, no gap, or unexplained, each as likely."""
    drawn = int(rng.integers(len(NAMES) + 2))
    if drawn == len(NAMES):
        return answer("no_gap", [])
    if drawn > len(NAMES):
        return answer("unexplained", [])
    name = NAMES[drawn]
    scope = CATALOGUE[name].scope if name in CATALOGUE else FAULTS[name].scope
    joints = [int(rng.integers(n_joints)) + 1] if scope == "joint" else []
    return answer("effects_found", [(name, joints)])


def largest_r2(design: Design) -> dict[str, Any]:
    """The one effect whose columns leave the smallest residual."""
    if design.nrmse.max() < NO_GAP:
        return answer("no_gap", [])
    shares = {effect: residual_share(design, effect) for effect in _effects(design)}
    best = min(shares, key=lambda effect: shares[effect])
    if shares[best] > 1.0 - EXPLAINED:
        return answer("unexplained", [])
    places = design.places(best)
    weights = np.abs(_fit(design, places))
    return answer("effects_found", [(best, _joints(design, places, weights))])


def forward_bic(design: Design) -> dict[str, Any]:
    """Columns one by one, the best first, as long as Bayes' information criterion falls."""
    chosen: list[int] = []
    total = float(design.gap @ design.gap)
    residual = design.gap
    score = _bic(residual, 0)
    while len(chosen) < MOST_COLUMNS:
        gain = np.abs(design.columns.T @ residual)
        gain[chosen] = 0.0
        candidate = [*chosen, int(gain.argmax())]
        fitted = design.columns[:, candidate] @ _fit(design, candidate)
        candidate_residual = design.gap - fitted
        candidate_score = _bic(candidate_residual, len(candidate))
        if candidate_score >= score:
            break
        chosen, residual, score = candidate, candidate_residual, candidate_score
    if not chosen or design.nrmse.max() < NO_GAP:
        return answer("no_gap", [])
    explained = residual @ residual < (1.0 - EXPLAINED) * total
    verdict = "effects_found" if explained else "unexplained"
    return answer(verdict, _named(design, chosen, np.abs(_fit(design, chosen))))


def _bic(residual: np.ndarray, terms: int) -> float:
    """Bayes' information criterion of a residual (M n,) after a fit of so many columns."""
    count = len(residual) / EFFECTIVE
    mean_square = max(float(residual @ residual), 1e-300) / len(residual)
    return float(count * np.log(mean_square) + terms * np.log(count))


def ridge(design: Design, penalty: float = 1e-2) -> dict[str, Any]:
    """All columns at once with a quadratic penalty; effects whose part of the gap is long enough are named."""
    if design.nrmse.max() < NO_GAP:
        return answer("no_gap", [])
    columns, gap = design.columns, design.gap
    normal = columns.T @ columns + penalty * np.eye(columns.shape[1])
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
) -> dict[str, Any]:
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
    return list(dict.fromkeys(term.effect for term in design.terms))


def _fit(design: Design, places: list[int]) -> np.ndarray:
    return np.linalg.lstsq(design.columns[:, places], design.gap, rcond=1e-8)[0]


def residual_share(design: Design, effect: str) -> float:
    """Share of the gap's squares that the columns of one effect do not explain."""
    places = design.places(effect)
    residual = design.gap - design.columns[:, places] @ _fit(design, places)
    return float(residual @ residual / (design.gap @ design.gap))


def _joints(design: Design, places: list[int], weights: np.ndarray) -> list[int]:
    """Joints whose weight is at least ``JOINT_SHARE`` of the largest; none for effects on the arm or a link."""
    terms = [design.terms[k] for k in places]
    if terms[0].joint == 0 or terms[0].effect == "link_inertia":
        return []
    least = JOINT_SHARE * weights.max()
    return [
        term.joint
        for term, weight in zip(terms, weights, strict=True)
        if weight >= least
    ]


def _named(
    design: Design, chosen: list[int], weights: np.ndarray
) -> list[tuple[str, list[int]]]:
    """Effects of chosen columns, longest first, without those below ``EFFECT_SHARE`` of the longest."""
    effects = [design.terms[k].effect for k in chosen]
    length: dict[str, float] = {}
    for effect, weight in zip(effects, weights, strict=True):
        length[effect] = float(np.hypot(length.get(effect, 0.0), weight))
    least = EFFECT_SHARE * max(length.values())
    long_enough = [effect for effect in length if length[effect] >= least]
    out = []
    for effect in sorted(long_enough, key=lambda effect: -length[effect]):
        own = [i for i, name in enumerate(effects) if name == effect]
        places = [chosen[i] for i in own]
        out.append((effect, _joints(design, places, weights[own])))
    return out
