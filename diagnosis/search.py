"""The search for the terms that explain the gap: forward by groups, with swaps and removal."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from arm.dynamics import RigidBody
from arm.nominal import NominalArm
from diagnosis.coordinates import COORDINATES
from diagnosis.data import Data
from diagnosis.evidence import Evidence, Fit, evidences
from diagnosis.linear import Linearisation
from diagnosis.terms import EXPLAINED, Term, Terms
from ident.conditioning import Segment, thinned

SEARCH_RATE = 100.0
"""The search works on segments decimated to no less than this [Hz]."""
MOST_LINEARISATIONS = 3
"""Linearisations around the values of one set of terms."""
LEAST_GAIN = 3.0
"""A move must raise the evidence by this much [nats]."""
MOST_STEPS = 12
"""Forward steps before the search gives up."""
CONTESTS = (("actuator_delay", "actuator_lag"),)
"""Effects with the same column where they begin."""
DECISIVE = 8.0
"""Evidence that decides between effects that look alike [nats]..."""
DECISIVE_NRMSE = 0.002
"""...if the unseen torque NRMSE of some joint differs by this much, more than the form of the model explains."""
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
    """Find the terms that explain the gap of recordings, judged on recordings left out of the fit."""
    state = _State(arm, body, [[thinned(s, SEARCH_RATE) for s in fold] for fold in folds], cutoff)
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
    state.contest()
    state.prune()
    state.polish()
    return Search(state.scale, state.fit, state.evidence, tuple(considered), state.contested)


def _describe(terms: frozenset[Term]) -> str:
    names = sorted({t.effect for t in terms})
    return "; ".join(f"{n} {sorted(t.joint for t in terms if t.effect == n and t.joint)}" for n in names)


class _State:
    """The model so far: its terms, the linearisation around its values, and the evidence on it."""

    def __init__(self, arm: NominalArm, body: RigidBody, folds: list[list[Segment]], cutoff: float) -> None:
        self.data = Data(arm, body, folds, cutoff)
        self.scale = self.data.torque_deviation
        terms = Terms(arm.n_joints)
        self.linear = Linearisation(self.data, np.zeros(terms.size), terms)
        gap = np.array([fold.gram[:, :, -1, -1].sum(axis=0) / fold.rows.sum(axis=0) for fold in self.linear.folds])
        self.evidences = evidences(self.linear, gap, frozenset())
        self.fit = self.evidence.fit(frozenset())
        self.contested: dict[tuple[str, str], float] = {}

    def accept(self, terms: frozenset[Term]) -> None:
        """Take a set of terms, less those whose values turn out impossible.

        Linearises around the values until they settle, and weighs the data anew each time.
        """
        for _ in range(MOST_LINEARISATIONS):
            fit = self._possible(terms)
            terms = fit.terms
            shapes = {**self.terms.shapes, **{t: shape.values for t, shape in self.linear.refined.items()}}
            self.linear = Linearisation(self.data, _settled(fit), Terms(self.terms.n_joints, shapes))
            self.evidences = evidences(self.linear, fit.unseen, terms)
            self.fit = self._possible(terms)
            terms = self.fit.terms
            if np.allclose(fit.theta, self.fit.theta, rtol=0.01, atol=1e-4):
                break

    @property
    def evidence(self) -> Evidence:
        """The evidence under the error of the nominal inertials that explains the data best."""
        return self.evidences[0]

    def best(self, terms: frozenset[Term]) -> Fit:
        """Fit of a set of terms under the error of the nominal inertials that suits it best.

        An effect that wide errors stood for until now needs narrow ones beside it.
        """
        return max((evidence.fit(terms) for evidence in self.evidences), key=lambda fit: fit.score)

    @property
    def terms(self) -> Terms:
        """All terms, with their shapes."""
        return self.linear.terms

    def contest(self) -> None:
        """Give effects that look alike to first order the place of each other, each around its own values.

        The second of a pair is named only where it is decisively better; where neither is, both stay open.
        """
        for first, second in CONTESTS:
            held = {t.effect for t in self.fit.terms} & {first, second}
            if len(held) != 1:
                continue
            chosen = held.pop()
            joints = {t.joint for t in self.fit.terms if t.effect == chosen}
            states = {chosen: (self.linear, self.evidences, self.fit)}
            other = second if chosen == first else first
            rest = frozenset(t for t in self.fit.terms if t.effect != chosen)
            self.accept(rest | {t for t in self.terms.open if t.effect == other and t.joint in joints})
            states[other] = (self.linear, self.evidences, self.fit)
            gain = states[second][2].score - states[first][2].score
            left = {name: nrmse(state[1][0], state[2].unseen, self.scale) for name, state in states.items()}
            decisive = abs(gain) > DECISIVE and np.abs(left[second] - left[first]).max() > DECISIVE_NRMSE
            winner, loser = (second, first) if decisive and gain > 0 else (first, second)
            self.contested[winner, loser] = -abs(gain) if decisive else -1.0
            self.linear, self.evidences, self.fit = states[winner]

    def _possible(self, terms: frozenset[Term]) -> Fit:
        """Fit of a set of terms, less those whose values are impossible."""
        fit = self.evidence.fit(terms)
        while fit.impossible:
            fit = self.evidence.fit(fit.terms - fit.impossible)
        return fit

    def refine(self) -> None:
        """Remove and swap terms while that raises the evidence."""
        been = {self.fit.terms}
        for _ in range(20):
            moves = [self.evidence.fit(s) for s in _neighbours(self.fit.terms, self.terms)]
            best = max(moves, key=lambda fit: fit.score, default=None)
            if best is None or best.score < self.fit.score + 0.5:
                break
            self.accept(best.terms)
            if self.fit.terms in been:
                break
            been.add(self.fit.terms)

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


def _settled(fit: Fit) -> np.ndarray:
    """Values around which to linearise: saturation is there or not, how much of it is in its shape."""
    theta = fit.theta.copy()
    theta[[t.columns[0] for t in fit.terms if t.effect == "torque_saturation"]] = 1.0
    return theta


def _by_effect(terms: frozenset[Term]) -> list[frozenset[Term]]:
    return [frozenset(t for t in terms if t.finding == name) for name in sorted({t.finding for t in terms})]


def _by_term(terms: frozenset[Term]) -> list[frozenset[Term]]:
    return [frozenset({t}) for t in sorted(terms, key=lambda t: (t.effect, t.joint))]


def _groups(state: _State) -> list[Fit]:
    """For each effect the best group of joints to add it on, if any raises the evidence."""
    found = (_group(state, effect) for effect in EXPLAINED)
    return [group for group in found if group is not None and group.score > state.fit.score]


def _group(state: _State, effect: str) -> Fit | None:
    """The best group of joints for one effect; joints are added in the order of their own gain, links one at a time."""
    group = None
    free = [t for t in state.terms.open if t.effect == effect and not _clashes(t, state.fit.terms, state.terms)]
    singles = sorted((state.evidence.fit(state.fit.terms | {t}) for t in free), key=lambda f: -f.score)
    if COORDINATES[effect].effect.scope != "joint":
        return state.best(singles[0].terms) if singles else None
    for single in singles:
        known = group or state.fit
        extended = state.evidence.fit(known.terms | single.terms)
        if extended.score > known.score:
            group = extended
    return state.best((group or singles[0]).terms) if singles else None


def _clashes(term: Term, chosen: frozenset[Term], terms: Terms) -> bool:
    """Whether a term is chosen already, or one that says the same of the same joint."""
    return term in chosen or any(t.effect == _same(term) and t.joint == term.joint for t in chosen)


def _same(term: Term) -> str | None:
    """The effect that looks like a term's to first order, with which it is contested."""
    return next((b if term.effect == a else a for a, b in CONTESTS if term.effect in (a, b)), None)


def _neighbours(chosen: frozenset[Term], terms: Terms) -> list[frozenset[Term]]:
    """Sets one move away: a term or an effect removed, a term swapped on its joint, an effect renamed."""
    moves = [chosen - {t} for t in chosen]
    of_joints = {t.effect for t in terms.open if t.coordinates.effect.scope == "joint"}
    for name in {t.effect for t in chosen}:
        mine = frozenset(t for t in chosen if t.effect == name)
        moves.append(chosen - mine)
        joints = {t.joint for t in mine}
        for other in of_joints - {t.effect for t in chosen} - {_same(t) for t in mine}:
            moves.append((chosen - mine) | {t for t in terms.open if t.effect == other and t.joint in joints})
    for term in chosen:
        rivals = [t for t in terms.open if t not in chosen and t.joint in (term.joint, 0) and t.effect != _same(term)]
        moves += [(chosen - {term}) | {rival} for rival in rivals]
        if term.joint == 0:
            moves += [(chosen - {term}) | {t} for t in terms.of("link_inertia")]
    return list(dict.fromkeys(moves))
