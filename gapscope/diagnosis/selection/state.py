"""The model so far: its terms, the linearisation around its values, and the evidence on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.model.fit_data import Data
from gapscope.diagnosis.model.linearisation import Linearisation
from gapscope.diagnosis.model.terms import Term, Terms
from gapscope.diagnosis.selection.evidence import Evidence, Fit, evidences
from gapscope.diagnosis.selection.moves import (
    by_finding,
    by_term,
    neighbours,
)
from gapscope.diagnosis.thresholds import (
    REFUSED_MOVES,
    RELINEARISATIONS,
    VISIBLE_EFFECT,
    VISIBLE_TERM,
)
from gapscope.ident.signals.conditioning import Segment


class Model(NamedTuple):
    """A set of terms, fitted around its own values.

    Attributes:
        linear: the linearisation.
        evidences: the evidence on it under each error of the nominal inertials, best first.
        fit: the terms and their values.
    """

    linear: Linearisation
    evidences: tuple[Evidence, ...]
    fit: Fit

    def gain(self, rival: Model) -> float:
        """Evidence of a rival less that of this model, each around its own values, by the same floors and samples."""
        one, other = self.evidences[0], rival.evidences[0]
        samples = 0.5 * (one.scored.independent + other.scored.independent)
        floor2 = 0.5 * (one.scored.floor2 + other.scored.floor2)
        mine, its = (
            float((samples * np.log1p(f.scored_mse / floor2)).sum())
            for f in (self.fit, rival.fit)
        )
        return 0.5 * (mine - its) - rival.fit.cost + self.fit.cost


class State:
    """The model so far, and moves from it."""

    def __init__(
        self,
        arm: NominalArm,
        body: RigidBody,
        folds: list[list[Segment]],
        cutoff: float,
    ) -> None:
        self.data = Data(arm, body, folds, cutoff)
        self.scale = self.data.torque_deviation
        terms = Terms(arm.n_joints)
        linear = Linearisation(self.data, np.zeros(terms.size), terms)
        scored = [fold.scored for fold in linear.folds]
        gap = np.array(
            [
                f.gram[:, :, -2, -2].sum(axis=0) / np.maximum(f.rows.sum(axis=0), 1e-9)
                for f in scored
            ]
        )
        weighed = evidences(linear, gap, frozenset())
        self.model = Model(linear, weighed, weighed[0].fit(frozenset()))
        self.contested: dict[tuple[str, str], float] = {}

    def fit_terms(
        self, terms: frozenset[Term], starts: Mapping[Term, np.ndarray] | None = None
    ) -> None:
        """Take a set of terms, less those whose values turn out impossible.

        Linearises around the values until they settle, and weighs the data anew each time.

        Args:
            terms: the set.
            starts: linear coordinates of some of them to linearise around at first, in the place of those fitted.
        """
        for _ in range(RELINEARISATIONS):
            fit = self._started(terms, starts) if starts else self._possible(terms)
            starts, terms = None, fit.terms
            shapes = {
                **self.terms.shapes,
                **{t: shape.values for t, shape in self.linear.refined.items()},
            }
            linear = Linearisation(
                self.data, settled(fit), Terms(self.terms.n_joints, shapes)
            )
            weighed = evidences(linear, fit.scored_mse, terms)
            self.model = Model(linear, weighed, weighed[0].fit(terms))
            self.model = self.model._replace(fit=self._possible(terms))
            terms = self.fit.terms
            if np.allclose(fit.theta, self.fit.theta, rtol=0.01, atol=1e-4):
                break

    @property
    def linear(self) -> Linearisation:
        """The linearisation around the values of the model."""
        return self.model.linear

    @property
    def evidences(self) -> tuple[Evidence, ...]:
        """The evidence under each error of the nominal inertials, best first."""
        return self.model.evidences

    @property
    def fit(self) -> Fit:
        """The terms of the model and their values."""
        return self.model.fit

    @property
    def evidence(self) -> Evidence:
        """The evidence under the error of the nominal inertials that explains the data best."""
        return self.evidences[0]

    def best(self, terms: frozenset[Term]) -> Fit:
        """Fit of a set of terms under the error of the nominal inertials that suits it best.

        An effect that wide errors stood for until now needs narrow ones beside it.
        """
        return max(
            (evidence.fit(terms) for evidence in self.evidences),
            key=lambda fit: fit.score,
        )

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

    def _started(
        self, terms: frozenset[Term], starts: Mapping[Term, np.ndarray]
    ) -> Fit:
        """Fit of a set of terms without those that start at given values, then set to these."""
        fit = self._possible(terms - frozenset(starts))
        theta = fit.theta.copy()
        for term, values in starts.items():
            theta[list(term.columns)] = values
        return replace(fit, terms=fit.terms | frozenset(starts), theta=theta)

    def refine(self) -> None:
        """Remove and swap terms while that raises the evidence, around their own values as well."""
        been, refused = {self.fit.terms}, 0
        for _ in range(20):
            moves = [
                self.evidence.fit(s)
                for s in neighbours(self.fit.terms, self.terms)
                if s not in been
            ]
            best = max(moves, key=lambda fit: fit.score, default=None)
            if (
                best is None
                or best.score < self.fit.score + 0.5
                or refused == REFUSED_MOVES
            ):
                break
            before = self.model
            been.add(best.terms)
            self.fit_terms(best.terms)
            been.add(self.fit.terms)
            if before.gain(self.model) < 0:
                self.model = before
                refused += 1

    def prune(self) -> None:
        """Take out, one by one, what no person could see: effects, then terms, whose loss hardly widens the gap.

        Joints that ring or play stay, as a model around their values says nothing of their absence.
        """
        for least, parts in ((VISIBLE_EFFECT, by_finding), (VISIBLE_TERM, by_term)):
            while calm := frozenset(
                t for t in self.fit.terms if t.definition.locally_linear
            ):
                loss = {
                    part: self._difference(self.fit.terms - part, self.fit.terms)
                    for part in parts(calm)
                }
                faintest = min(loss, key=lambda part: loss[part])
                if loss[faintest] >= least:
                    break
                self.fit_terms(self.fit.terms - faintest)

    def visible(self, terms: frozenset[Term]) -> bool:
        """Whether more terms close enough of the gap for a person to see it."""
        named = {t.effect for t in terms} <= {t.effect for t in self.fit.terms}
        return self._difference(self.fit.terms, terms) >= (
            VISIBLE_TERM if named else VISIBLE_EFFECT
        )

    def closed(self, before: Model) -> float:
        """How much of the torque NRMSE of some joint the model closes that another leaves, each by its own values.

        With the errors of the nominal inertials taken out or not, whichever is more.
        """

        def left(model: Model, corrected: bool) -> np.ndarray:
            evidence = model.evidences[0]
            return nrmse(
                evidence,
                evidence.held_out_mse(model.fit.terms, corrected=corrected),
                self.scale,
            )

        return max(
            float((left(before, c) - left(self.model, c)).max()) for c in (False, True)
        )

    def _difference(self, few: frozenset[Term], many: frozenset[Term]) -> float:
        """How much of the torque NRMSE of some joint more terms close: unseen, or fitted, whichever is less.

        A slow recording alone may fix a delay so badly that any further term seems to help on the fast one left out;
        fitted to all recordings such a term does nothing. Where errors of the nominal inertials hide an effect under a
        wider gap of their own, what it closes once they are taken out counts too.
        """
        evidence = self.evidence

        def closed(gap: Callable[..., np.ndarray], corrected: bool) -> float:
            few_left, many_left = (
                nrmse(evidence, gap(s, corrected=corrected), self.scale)
                for s in (few, many)
            )
            return float((few_left - many_left).max())

        plain, corrected = (
            min(closed(evidence.held_out_mse, c), closed(evidence.in_sample_mse, c))
            for c in (False, True)
        )
        return max(plain, corrected) if plain > 0 else plain

    def relinearise(self) -> None:
        """Linearise once more around the final values."""
        if self.fit.terms:
            self.fit_terms(self.fit.terms)


def nrmse(
    evidence: Evidence, held_out_mse: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """Torque NRMSE per joint, (n,), from the mean square of the gap per fold and joint."""
    return (
        np.sqrt((held_out_mse * evidence.rows).sum(axis=0) / evidence.rows.sum(axis=0))
        / scale
    )


def settled(fit: Fit) -> np.ndarray:
    """Values around which to linearise: saturation is there or not, how much of it is in its shape."""
    theta = fit.theta.copy()
    theta[[t.columns[0] for t in fit.terms if t.definition.limits]] = 1.0
    return theta
