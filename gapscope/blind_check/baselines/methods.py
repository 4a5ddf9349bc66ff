"""Plain methods; each answers with a verdict and effects in the form of ``diagnosis.json``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gapscope.blind_check.baselines.columns import Design
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.setup_faults import FAULTS

NO_GAP = 0.03
"""Torque NRMSE of the worst joint below which there is no gap."""
EXPLAINED = 0.7
"""Share of the gap's squares above which it counts as explained."""
EFFECTIVE = 10
"""Rows that count as one independent observation."""
NAMED = 0.1
"""Share of the gap's length that an effect needs to be named by ridge regression."""
NAMES = (*CATALOGUE, *FAULTS)


def chance(n_joints: int, rng: np.random.Generator) -> dict[str, Any]:
    """Any effect on any joint, no gap, or unexplained, each as likely."""
    drawn = int(rng.integers(len(NAMES) + 2))
    if drawn >= len(NAMES):
        return answer("no_gap" if drawn == len(NAMES) else "unexplained", [])
    name = NAMES[drawn]
    scope = CATALOGUE[name].scope if name in CATALOGUE else FAULTS[name].scope
    return answer(
        "effects_found",
        [(name, [int(rng.integers(n_joints)) + 1] if scope == "joint" else [])],
    )


def largest_r2(design: Design) -> dict[str, Any]:
    """The one effect whose columns leave the least of the gap."""
    if design.nrmse.max() < NO_GAP:
        return answer("no_gap", [])
    left = {effect: left_by(design, effect) for effect in _effects(design)}
    best = min(left, key=lambda effect: left[effect])
    if left[best] > 1.0 - EXPLAINED:
        return answer("unexplained", [])
    places = design.places(best)
    weights = np.abs(_fit(design, places))
    return answer("effects_found", [(best, _joints(design, places, weights, 0.2))])


def forward_bic(design: Design) -> dict[str, Any]:
    """Columns one by one, the best first, as long as Bayes' information criterion falls."""
    count = len(design.gap) / EFFECTIVE
    chosen: list[int] = []
    total = float(design.gap @ design.gap)
    residual, score = design.gap, count * np.log(total / len(design.gap))
    while len(chosen) < 25:
        gain = np.abs(design.columns.T @ residual)
        gain[chosen] = 0.0
        candidate = [*chosen, int(gain.argmax())]
        left = design.gap - design.columns[:, candidate] @ _fit(design, candidate)
        new = count * np.log(max(float(left @ left), 1e-300) / len(left)) + len(
            candidate
        ) * np.log(count)
        if new >= score:
            break
        chosen, residual, score = candidate, left, new
    if not chosen or design.nrmse.max() < NO_GAP:
        return answer("no_gap", [])
    verdict = (
        "effects_found"
        if residual @ residual < (1.0 - EXPLAINED) * total
        else "unexplained"
    )
    return answer(verdict, _named(design, chosen, np.abs(_fit(design, chosen)), 0.15))


def ridge(design: Design, penalty: float = 1e-2) -> dict[str, Any]:
    """All columns at once with a quadratic penalty; effects whose part of the gap is long enough are named."""
    if design.nrmse.max() < NO_GAP:
        return answer("no_gap", [])
    a = design.columns
    weights = np.linalg.solve(a.T @ a + penalty * np.eye(a.shape[1]), a.T @ design.gap)
    left = design.gap - a @ weights
    found = []
    for effect in _effects(design):
        places = design.places(effect)
        part = np.linalg.norm(a[:, places] @ weights[places]) / np.linalg.norm(
            design.gap
        )
        if part > NAMED:
            found.append(
                (part, effect, _joints(design, places, np.abs(weights[places]), 0.2))
            )
    verdict = (
        "effects_found"
        if left @ left < (1.0 - EXPLAINED) * design.gap @ design.gap and found
        else "unexplained"
    )
    return answer(
        verdict, [(effect, joints) for _, effect, joints in sorted(found, reverse=True)]
    )


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


def left_by(design: Design, effect: str) -> float:
    """Share of the gap's squares that the columns of one effect leave."""
    places = design.places(effect)
    left = design.gap - design.columns[:, places] @ _fit(design, places)
    return float(left @ left / (design.gap @ design.gap))


def _joints(
    design: Design, places: list[int], weights: np.ndarray, share: float
) -> list[int]:
    """Joints whose weight is at least a share of the largest; none for effects on the arm or a link."""
    terms = [design.terms[k] for k in places]
    if terms[0].joint == 0 or terms[0].effect == "link_inertia":
        return []
    return [
        term.joint
        for term, weight in zip(terms, weights, strict=True)
        if weight >= share * weights.max()
    ]


def _named(
    design: Design, chosen: list[int], weights: np.ndarray, share: float
) -> list[tuple[str, list[int]]]:
    """Effects of chosen columns, longest first, without those that add next to nothing."""
    length: dict[str, float] = {}
    for k, weight in zip(chosen, weights, strict=True):
        length[design.terms[k].effect] = float(
            np.hypot(length.get(design.terms[k].effect, 0.0), weight)
        )
    floor = share * max(length.values())
    ordered = sorted(
        (name for name in length if length[name] >= floor),
        key=lambda name: -length[name],
    )
    out = []
    for name in ordered:
        mine = [i for i, k in enumerate(chosen) if design.terms[k].effect == name]
        out.append(
            (name, _joints(design, [chosen[i] for i in mine], weights[mine], 0.2))
        )
    return out
