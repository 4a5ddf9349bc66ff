"""The model so far: its terms, the linearisation around its values, and the evidence on it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from arm.dynamics import RigidBody
from arm.nominal import NominalArm
from diagnosis.data import Data
from diagnosis.evidence import Evidence, Fit, evidences
from diagnosis.linear import Linearisation
from diagnosis.moves import by_finding, by_term, neighbours
from diagnosis.terms import Term, Terms
from ident.conditioning import Segment

MOST_LINEARISATIONS = 3
"""Linearisations around the values of one set of terms."""
VISIBLE_EFFECT = 0.01
"""An effect must lower the unseen torque NRMSE of some joint by this much to be named."""
VISIBLE_TERM = 0.004
"""A joint must gain this much in unseen torque NRMSE to be named with an effect that is named anyway."""


class State:
    """The model so far: its terms, the linearisation around its values, and the evidence on it."""

    def __init__(self, arm: NominalArm, body: RigidBody, folds: list[list[Segment]], cutoff: float) -> None:
        self.data = Data(arm, body, folds, cutoff)
        self.scale = self.data.torque_deviation
        terms = Terms(arm.n_joints)
        self.linear = Linearisation(self.data, np.zeros(terms.size), terms)
        told = [fold.told for fold in self.linear.folds]
        gap = np.array([f.gram[:, :, -1, -1].sum(axis=0) / np.maximum(f.rows.sum(axis=0), 1e-9) for f in told])
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
            self.linear = Linearisation(self.data, settled(fit), Terms(self.terms.n_joints, shapes))
            self.evidences = evidences(self.linear, fit.missed, terms)
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
            moves = [self.evidence.fit(s) for s in neighbours(self.fit.terms, self.terms)]
            best = max(moves, key=lambda fit: fit.score, default=None)
            if best is None or best.score < self.fit.score + 0.5:
                break
            self.accept(best.terms)
            if self.fit.terms in been:
                break
            been.add(self.fit.terms)

    def prune(self) -> None:
        """Take out, one by one, what no person could see: effects, then terms, whose loss hardly widens the gap."""
        for least, parts in ((VISIBLE_EFFECT, by_finding), (VISIBLE_TERM, by_term)):
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


def settled(fit: Fit) -> np.ndarray:
    """Values around which to linearise: saturation is there or not, how much of it is in its shape."""
    theta = fit.theta.copy()
    theta[[t.columns[0] for t in fit.terms if t.effect == "torque_saturation"]] = 1.0
    return theta
