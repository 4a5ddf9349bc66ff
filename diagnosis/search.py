"""The search for the terms that explain the gap: forward by groups, with swaps and removal."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from arm.dynamics import RigidBody
from arm.nominal import NominalArm
from diagnosis.contests import contest, doubt, prefer_payload
from diagnosis.coordinates import COORDINATES
from diagnosis.evidence import Evidence, Fit
from diagnosis.moves import clashes
from diagnosis.state import State
from diagnosis.terms import EXPLAINED, Term
from ident.conditioning import Segment, thinned

SEARCH_RATE = 100.0
"""The search works on segments decimated to no less than this [Hz]."""
LEAST_GAIN = 3.0
"""A move must raise the evidence by this much [nats]."""
MOST_STEPS = 12
"""Forward steps before the search gives up."""


@dataclass(frozen=True)
class Search:
    """Result of a search.

    Attributes:
        scale: normalisation of the torque gap over all folds [N m], (n,).
        fit: the best set of terms, fitted at its own linearisation.
        evidence: the evidence that scored it.
        contested: evidence of a rival less that of an effect found, each around its own values [nats].
        considered: gain of the best group of each effect over what was chosen, in nats: the rivals at each step.
    """

    scale: np.ndarray
    fit: Fit
    evidence: Evidence
    considered: tuple[tuple[Fit, Fit], ...]
    contested: Mapping[tuple[str, str], float]


def search(
    arm: NominalArm,
    body: RigidBody,
    folds: list[list[Segment]],
    cutoff: float,
    progress: Callable[[str], None] = lambda message: None,
) -> Search:
    """Find the terms that explain the gap of recordings, judged on halves of recordings left out of the fit."""
    state = State(arm, body, [[thinned(s, SEARCH_RATE) for s in fold] for fold in folds], cutoff)
    considered: list[tuple[Fit, Fit]] = []
    been = {state.fit.terms}
    for _ in range(MOST_STEPS):
        groups = [fit for fit in _groups(state) if state.visible(fit.terms)]
        groups.sort(key=lambda fit: fit.score, reverse=True)
        if not groups or groups[0].score < state.fit.score + LEAST_GAIN:
            break
        considered += [(groups[0], rival) for rival in groups[1:4]]
        progress("adds " + _describe(groups[0].terms - state.fit.terms))
        state.accept(groups[0].terms)
        state.refine()
        if state.fit.terms in been:
            break
        been.add(state.fit.terms)
    contest(state)
    prefer_payload(state)
    doubt(state)
    state.prune()
    state.polish()
    return Search(state.scale, state.fit, state.evidence, tuple(considered), state.contested)


def _describe(terms: frozenset[Term]) -> str:
    names = sorted({t.effect for t in terms})
    return "; ".join(f"{n} {sorted(t.joint for t in terms if t.effect == n and t.joint)}" for n in names)


def _groups(state: State) -> list[Fit]:
    """For each effect the best group of joints to add it on, if any raises the evidence."""
    found = (_group(state, effect) for effect in EXPLAINED)
    return [group for group in found if group is not None and group.score > state.fit.score]


def _group(state: State, effect: str) -> Fit | None:
    """The best group of joints for one effect; joints are added in the order of their own gain, links one at a time."""
    group = None
    free = [t for t in state.terms.open if t.effect == effect and not clashes(t, state.fit.terms, state.terms)]
    singles = sorted((state.evidence.fit(state.fit.terms | {t}) for t in free), key=lambda f: -f.score)
    if COORDINATES[effect].effect.scope != "joint":
        return state.best(singles[0].terms) if singles else None
    for single in singles:
        known = group or state.fit
        extended = state.evidence.fit(known.terms | single.terms)
        if extended.score > known.score:
            group = extended
    return state.best((group or singles[0]).terms) if singles else None
