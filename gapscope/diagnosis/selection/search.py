"""The search for the terms that explain the gap: forward by groups and by pairs of them, with swaps and removal."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.model.terms import Term
from gapscope.diagnosis.selection.evidence import Evidence, Fit
from gapscope.diagnosis.selection.moves import clashes, near_equivalent
from gapscope.diagnosis.selection.near_equivalents import (
    compare_near_equivalents,
    drop_unneeded_compliance,
    prefer_payload,
)
from gapscope.diagnosis.selection.resonance_starts import starts
from gapscope.diagnosis.selection.state import State
from gapscope.diagnosis.thresholds import (
    COMPLIANCE_STARTS_TRIED,
    FORWARD_STEPS,
    GROUPS_TRIED,
    MOVE_GAIN,
    PAIRED_GROUPS,
    SEARCH_RATE,
    VISIBLE_EFFECT,
)
from gapscope.effects.catalogue import effect as by_name
from gapscope.effects.catalogue import explained
from gapscope.ident.signals.conditioning import Segment, thinned


@dataclass(frozen=True)
class Selection:
    """Result of a search.

    Attributes:
        scale: normalisation of the torque gap over all folds [N m], (n,).
        fit: the best set of terms, fitted at its own linearisation.
        evidence: the evidence that scored it.
        nothing: mean square of the gap per fold and joint without any effect [N^2 m^2], (F, n).
        contested: evidence of a rival less that of an effect found, each around its own values [nats].
        considered: gain of the best group of each effect over what was chosen, in nats: the rivals at each step.
    """

    scale: np.ndarray
    fit: Fit
    evidence: Evidence
    considered: tuple[tuple[Fit, Fit], ...]
    contested: Mapping[tuple[str, str], float]
    nominal_mse: np.ndarray


def search(
    arm: NominalArm,
    body: RigidBody,
    folds: list[list[Segment]],
    cutoff: float,
    progress: Callable[[str], None] = lambda message: None,
) -> Selection:
    """Find the terms that explain the gap of recordings, judged on halves of recordings left out of the fit."""
    state = State(
        arm, body, [[thinned(s, SEARCH_RATE) for s in fold] for fold in folds], cutoff
    )
    considered: list[tuple[Fit, Fit]] = []
    nominal_mse = state.fit.held_out_mse
    _forward(state, considered, progress)
    while _rings(state, progress) or _pair(state, progress):
        _forward(state, considered, progress)
    compare_near_equivalents(state)
    prefer_payload(state)
    drop_unneeded_compliance(state)
    state.prune()
    state.relinearise()
    return Selection(
        state.scale,
        state.fit,
        state.evidence,
        tuple(considered),
        state.contested,
        nominal_mse,
    )


def _forward(
    state: State, considered: list[tuple[Fit, Fit]], progress: Callable[[str], None]
) -> None:
    """Add the best group of terms while one raises the evidence, each around its own values."""
    been, refused = {state.fit.terms}, set()
    for _ in range(FORWARD_STEPS):
        groups = [
            fit
            for fit in _groups(state)
            if state.visible(fit.terms) and fit.terms not in refused
        ]
        groups.sort(key=lambda fit: fit.score, reverse=True)
        groups = [
            fit
            for fit in groups[:GROUPS_TRIED]
            if fit.score >= state.fit.score + MOVE_GAIN
        ]
        before = state.model
        for k, group in enumerate(groups):
            state.fit_terms(group.terms)
            if before.gain(state.model) > 0:
                considered += [(group, rival) for rival in groups[k + 1 : k + 4]]
                progress("adds " + _describe(group.terms - before.fit.terms))
                break
            refused.add(group.terms)
            state.model = before
        else:
            return
        state.refine()
        if state.fit.terms in been:
            return
        been.add(state.fit.terms)


def _rings(state: State, progress: Callable[[str], None]) -> bool:
    """Add a joint that rings or plays, if one explains what is left."""
    before = state.model
    for start in starts(state)[:COMPLIANCE_STARTS_TRIED]:
        state.fit_terms(before.fit.terms | {start.term}, {start.term: start.values})
        better = (
            before.gain(state.model) > MOVE_GAIN
            and state.closed(before) >= VISIBLE_EFFECT
        )
        if start.term in state.fit.terms and better:
            progress("adds " + _describe(frozenset({start.term})))
            state.refine()
            return True
        state.model = before
    return False


def _pair(state: State, progress: Callable[[str], None]) -> bool:
    """Add the best pair of effects that explain only together what is left, if there is one.

    Not beside a joint that rings or plays, whose form leaves more than a pair that shows alone in neither part.
    """
    before = state.model
    if any(not t.definition.locally_linear for t in before.fit.terms):
        return False
    found = (_group(state, effect.name) for effect in explained())
    groups = sorted((g for g in found if g is not None), key=lambda fit: -fit.score)[
        :PAIRED_GROUPS
    ]
    sets = [
        a.terms | b.terms
        for a, b in combinations(groups, 2)
        if not _contested(a.terms | b.terms)
    ]
    fits = [fit for fit in map(state.best, sets) if state.visible(fit.terms)]
    best = max(fits, key=lambda fit: fit.score, default=before.fit)
    if best.score < before.fit.score + MOVE_GAIN:
        return False
    state.fit_terms(best.terms)
    if before.gain(state.model) > MOVE_GAIN and len(state.fit.terms) > len(
        before.fit.terms
    ):
        progress("adds " + _describe(state.fit.terms - before.fit.terms))
        state.refine()
        return True
    state.model = before
    return False


def _contested(terms: frozenset[Term]) -> bool:
    """Whether two of the terms say the same of one joint."""
    return any(
        a.joint == b.joint and a.effect == near_equivalent(b)
        for a in terms
        for b in terms
    )


def _describe(terms: frozenset[Term]) -> str:
    names = sorted({t.effect for t in terms})
    return "; ".join(
        f"{n} {sorted(t.joint for t in terms if t.effect == n and t.joint)}"
        for n in names
    )


def _groups(state: State) -> list[Fit]:
    """For each effect the best group of joints to add it on, if any raises the evidence."""
    found = (_group(state, effect.name) for effect in explained())
    return [
        group for group in found if group is not None and group.score > state.fit.score
    ]


def _group(state: State, effect: str) -> Fit | None:
    """The best group of joints for one effect; joints are added in the order of their own gain, links one at a time."""
    group = None
    free = [
        t
        for t in state.terms.open
        if t.effect == effect and not clashes(t, state.fit.terms, state.terms)
    ]
    singles = sorted(
        (state.evidence.fit(state.fit.terms | {t}) for t in free),
        key=lambda f: -f.score,
    )
    if by_name(effect).scope != "joint":
        return state.best(singles[0].terms) if singles else None
    for single in singles:
        known = group or state.fit
        extended = state.evidence.fit(known.terms | single.terms)
        if extended.score > known.score:
            group = extended
    return state.best((group or singles[0]).terms) if singles else None
