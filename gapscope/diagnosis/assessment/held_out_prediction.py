"""How far: the gap of sets of terms on data that they were not fitted to, and the share of each effect."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from math import factorial

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.gap.torque_gap import TorqueGap, torque_gap
from gapscope.diagnosis.model.terms import Term
from gapscope.diagnosis.selection.search import Selection
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.signals.conditioning import Segment


class HeldOutPredictor:
    """Predicts unseen data with sets of terms.

    Args:
        arm, body: the nominal arm and its dynamics.
        found: result of the search.
        folds: segments per fold; each half of one is predicted with values fitted to its other half and to the
            other folds.
        judged: segments set aside for judging; where there are any, they alone are predicted, with all folds fitted.
    """

    def __init__(
        self,
        arm: NominalArm,
        body: RigidBody,
        selection: Selection,
        folds: list[list[Segment]],
        judged: list[Segment],
    ) -> None:
        self.arm, self.body, self.selection, self.folds, self.judged = (
            arm,
            body,
            selection,
            folds,
            judged,
        )

    @property
    def segments(self) -> list[Segment]:
        """The segments that are predicted."""
        return self.judged or [segment for fold in self.folds for segment in fold]

    def gap(self, terms: frozenset[Term]) -> TorqueGap:
        """Gap on unseen data of the nominal arm plus some of the terms, fitted anew."""
        return self.measured(
            terms, lambda arm, segments: torque_gap(arm, self.body, segments)
        )

    def measured(
        self,
        terms: frozenset[Term],
        gap: Callable[[CorrectedArm, list[Segment]], TorqueGap],
    ) -> TorqueGap:
        """Any gap on unseen data, from a function of an arm and segments."""
        evidence = self.selection.evidence
        if self.judged:
            return gap(self._corrected(evidence.fit(terms).theta, terms), self.judged)
        gaps = [
            _joined(*(gap(self._corrected(theta, terms), fold) for theta in halves))
            for halves, fold in zip(evidence.left_out(terms), self.folds, strict=True)
        ]
        lengths = np.cumsum(
            [0, *(b - a for g in gaps for a, b in itertools.pairwise(g.edges))]
        )
        return TorqueGap(
            np.vstack([g.measured for g in gaps]),
            np.vstack([g.predicted for g in gaps]),
            tuple(int(x) for x in lengths),
        )

    def _corrected(self, theta: np.ndarray, terms: frozenset[Term]) -> CorrectedArm:
        known = self.selection.evidence.terms
        return CorrectedArm(self.arm, known.effects(known.clipped(theta), terms))

    def shares(self, draws: int = 200) -> dict[str, Share]:
        """Share of each effect in the gap closed, by Shapley's value over all orders of adding them.

        The worth of a set is the sum over joints of the unseen torque NRMSE that it closes; shares add up to the
        closed part of the gap above the floor, at most 1. Intervals are from folds drawn with replacement.
        """
        evidence, chosen = self.selection.evidence, self.selection.fit.terms
        names = sorted({t.finding for t in chosen})
        subsets = [
            s for size in range(len(names) + 1) for s in combinations(names, size)
        ]
        held_out_mse = {
            subset: evidence.held_out_mse(
                frozenset(t for t in chosen if t.finding in subset), corrected=False
            )
            for subset in subsets
        }
        folds = len(evidence.rows)
        counts = np.random.default_rng(0).multinomial(
            folds, np.full(folds, 1 / folds), size=draws
        )
        weights = np.vstack([np.ones(folds), counts])[:, :, None] * evidence.rows

        def closed(square: np.ndarray) -> np.ndarray:
            """Sum over joints of the NRMSE under each draw of folds, the first draw all of them once."""
            mean = (square * weights).sum(axis=1) / np.maximum(
                weights.sum(axis=1), 1e-12
            )
            return np.asarray((np.sqrt(mean) / self.selection.scale).sum(axis=1))

        worth = {subset: -closed(square) for subset, square in held_out_mse.items()}
        above = -worth[()] - closed(evidence.floor2)
        above = np.maximum(np.maximum(above, worth[tuple(names)] - worth[()]), 1e-12)
        return {name: Share.of(_shapley(name, names, worth) / above) for name in names}


@dataclass(frozen=True)
class Share:
    """An effect's share of the gap above the floor, and where nine of ten draws of the folds put it."""

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, draws: np.ndarray) -> Share:
        """The share of the first draw, and the interval of the others; all within 0 and 1."""
        inside = np.clip(draws, 0.0, 1.0)
        low, high = np.quantile(inside[1:], [0.05, 0.95])
        return cls(float(inside[0]), float(low), float(high))


def _shapley(
    name: str, names: list[str], worth: dict[tuple[str, ...], np.ndarray]
) -> np.ndarray:
    """Shapley's value of one of the names, given the worth of every subset in sorted order."""
    others = [n for n in names if n != name]
    total = np.zeros_like(worth[()])
    for k in range(len(others) + 1):
        weight = factorial(k) * factorial(len(names) - k - 1) / factorial(len(names))
        for subset in combinations(others, k):
            total += weight * (worth[tuple(sorted((*subset, name)))] - worth[subset])
    return total


def _joined(first: TorqueGap, second: TorqueGap) -> TorqueGap:
    """The first half of one gap and the second half of another on the same samples."""
    middle = len(first.measured) // 2
    measured, predicted = (
        np.vstack([getattr(first, name)[:middle], getattr(second, name)[middle:]])
        for name in ("measured", "predicted")
    )
    return TorqueGap(measured, predicted, first.edges)
