"""The search for the terms that explain the gap: forward by groups, with swaps and removal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from arm.dynamics import RigidBody
from arm.nominal import NominalArm
from diagnosis.evidence import Evidence, Fit, best_evidence
from diagnosis.linear import Data, Linearisation
from diagnosis.terms import EXPLAINED, Term, Terms
from ident.conditioning import Segment

MOST_LINEARISATIONS = 3
"""Linearisations around the values of one set of terms."""
LEAST_GAIN = 3.0
"""A move must raise the evidence by this much [nats]."""
MOST_STEPS = 12
"""Forward steps before the search gives up."""
VISIBLE_EFFECT = 0.01
"""An effect must lower the unseen torque NRMSE of some joint by this much to be named."""
VISIBLE_TERM = 0.004
"""A joint must gain this much in unseen torque NRMSE to be named with an effect that is named anyway."""


@dataclass(frozen=True)
class Search:
    """Result of a search.

    Attributes:
        scale: normalisation of the torque gap over all folds [N m], (n,).
        fit: the best set of terms, fitted at its own linearisation.
        evidence: the evidence that scored it.
        considered: gain of the best group of each effect over what was chosen, in nats: the rivals at each step.
    """

    scale: np.ndarray
    fit: Fit
    evidence: Evidence
    considered: tuple[tuple[Fit, Fit], ...]


def search(
    arm: NominalArm,
    body: RigidBody,
    folds: list[list[Segment]],
    cutoff: float,
    progress: Callable[[str], None] = lambda message: None,
) -> Search:
    """Find the terms that explain the gap of recordings, judged on recordings left out of the fit."""
    terms = Terms(arm.n_joints)
    state = _State(arm, body, terms, folds, cutoff)
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
    state.prune()
    state.polish()
    return Search(state.scale, state.fit, state.evidence, tuple(considered))


def _describe(terms: frozenset[Term]) -> str:
    names = sorted({t.effect for t in terms})
    return "; ".join(f"{n} {sorted(t.joint for t in terms if t.effect == n and t.joint)}" for n in names)


class _State:
    """The model so far: its terms, the linearisation around its values, and the evidence on it."""

    def __init__(
        self, arm: NominalArm, body: RigidBody, terms: Terms, folds: list[list[Segment]], cutoff: float
    ) -> None:
        self.terms, self.data = terms, Data(arm, body, folds, cutoff)
        self.scale = self.data.torque_deviation
        self.linear = Linearisation(self.data, terms, np.zeros(terms.size))
        gap = np.array([fold.gram[:, :, -1, -1].sum(axis=0) / fold.rows.sum(axis=0) for fold in self.linear.folds])
        self.evidence = best_evidence(self.linear, gap, frozenset())
        self.fit = self.evidence.fit(frozenset())

    def accept(self, terms: frozenset[Term]) -> None:
        """Take a set of terms, less those whose values turn out impossible.

        Linearises around the values until they settle, and weighs the data anew each time.
        """
        for _ in range(MOST_LINEARISATIONS):
            fit = self._possible(terms)
            terms = fit.terms
            self.linear = Linearisation(self.data, self.terms, fit.theta)
            self.evidence = best_evidence(self.linear, fit.unseen, terms)
            self.fit = self._possible(terms)
            terms = self.fit.terms
            if np.allclose(fit.theta, self.fit.theta, rtol=0.01, atol=1e-4):
                break

    def _possible(self, terms: frozenset[Term]) -> Fit:
        """Fit of a set of terms, less those whose values are impossible."""
        fit = self.evidence.fit(terms)
        while fit.impossible:
            fit = self.evidence.fit(fit.terms - fit.impossible)
        return fit

    def refine(self) -> None:
        """Remove and swap terms while that raises the evidence."""
        for _ in range(20):
            moves = [self.evidence.fit(s) for s in _neighbours(self.fit.terms, self.terms)]
            best = max(moves, key=lambda fit: fit.score, default=None)
            if best is None or best.score < self.fit.score + 0.5:
                break
            self.accept(best.terms)

    def prune(self) -> None:
        """Take out, one by one, what no person could see: effects, then terms, whose loss hardly widens the gap."""
        for least, parts in ((VISIBLE_EFFECT, _by_effect), (VISIBLE_TERM, _by_term)):
            while self.fit.terms:
                loss = {part: self._loss(part) for part in parts(self.fit.terms)}
                faintest = min(loss, key=lambda part: loss[part])
                if loss[faintest] >= least:
                    break
                self.accept(self.fit.terms - faintest)

    def visible(self, terms: frozenset[Term]) -> bool:
        """Whether more terms close enough of the gap for a person to see it."""
        named = {t.effect for t in terms} <= {t.effect for t in self.fit.terms}
        return self._difference(self.fit.terms, terms) >= (VISIBLE_TERM if named else VISIBLE_EFFECT)

    def _loss(self, part: frozenset[Term]) -> float:
        return self._difference(self.fit.terms - part, self.fit.terms)

    def _difference(self, few: frozenset[Term], many: frozenset[Term]) -> float:
        """How much of the torque NRMSE of some joint more terms close: unseen, or fitted, whichever is less.

        A slow recording alone may fix a delay so badly that any further term seems to help on the fast one left out;
        fitted to all recordings such a term does nothing. Where errors of the nominal inertials hide an effect under a
        wider gap of their own, what it closes once they are taken out counts too.
        """
        evidence = self.evidence

        def closed(gap: Callable[..., np.ndarray], corrected: bool) -> float:
            few_left, many_left = (nrmse(evidence, gap(s, corrected=corrected), self.scale) for s in (few, many))
            return float((few_left - many_left).max())

        plain, corrected = (min(closed(evidence.unseen, c), closed(evidence.seen, c)) for c in (False, True))
        return max(plain, corrected) if plain > 0 else plain

    def polish(self) -> None:
        """Linearise once more around the final values."""
        if self.fit.terms:
            self.accept(self.fit.terms)


def nrmse(evidence: Evidence, unseen: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Torque NRMSE per joint, (n,), from the mean square of the gap per fold and joint."""
    return np.sqrt((unseen * evidence.rows).sum(axis=0) / evidence.rows.sum(axis=0)) / scale


def _by_effect(terms: frozenset[Term]) -> list[frozenset[Term]]:
    return [frozenset(t for t in terms if t.effect == name) for name in sorted({t.effect for t in terms})]


def _by_term(terms: frozenset[Term]) -> list[frozenset[Term]]:
    return [frozenset({t}) for t in sorted(terms, key=lambda t: (t.effect, t.joint))]


def _groups(state: _State) -> list[Fit]:
    """For each effect the best group of joints to add it on, if any raises the evidence."""
    found = (_group(state, effect) for effect in EXPLAINED)
    return [group for group in found if group is not None]


def _group(state: _State, effect: str) -> Fit | None:
    """The best group of joints for one effect; joints are added in the order of their own gain."""
    best = None
    free = [t for t in state.terms.all if t.effect == effect and t not in state.fit.terms]
    for single in sorted((state.evidence.fit(state.fit.terms | {t}) for t in free), key=lambda f: -f.score):
        known = best or state.fit
        extended = state.evidence.fit(known.terms | single.terms)
        if extended.score > known.score:
            best = extended
    return best


def _neighbours(chosen: frozenset[Term], terms: Terms) -> list[frozenset[Term]]:
    """Sets one move away: a term or an effect removed, a term swapped on its joint, an effect renamed."""
    moves = [chosen - {t} for t in chosen]
    effects = {t.effect for t in chosen}
    for name in effects:
        moves.append(chosen - {t for t in chosen if t.effect == name})
        joints = {t.joint for t in chosen if t.effect == name}
        for other in {t.effect for t in terms.all} - effects - {"payload"}:
            renamed = {t for t in terms.all if t.effect == other and t.joint in joints}
            moves.append((chosen - {t for t in chosen if t.effect == name}) | renamed)
    for term in chosen:
        rivals = [t for t in terms.all if t not in chosen and (t.joint == term.joint or t.effect == "payload")]
        moves += [(chosen - {term}) | {rival} for rival in rivals]
    return list(dict.fromkeys(moves))
