"""How far: the gap of sets of terms on data that they were not fitted to, and the share of each effect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import factorial

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.selection.search import Selection
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import Segment
from gapscope.model.terms import Term
from gapscope.model.torque_gap import TorqueGap, torque_gap

SHARE_DRAWS = 200
"""Draws of folds behind the interval of a share."""

GapOf = Callable[[CorrectedArm, list[Segment]], TorqueGap]
"""A gap of an arm on segments."""


@dataclass(frozen=True)
class HeldOutPredictor:
    """Predicts held-out data with sets of terms.

    Attributes:
        arm, body: the nominal arm and its dynamics.
        selection: result of the search.
        folds: segments per fold; each half of one is predicted with values fitted to its other half and to the
            other folds.
        set_aside: segments of recordings that are never fitted; if there are any, they alone are predicted, with
            values fitted to all folds.
    """

    arm: NominalArm
    body: RigidBody
    selection: Selection
    folds: list[list[Segment]]
    set_aside: list[Segment]
    _gaps: dict[frozenset[Term], TorqueGap] = field(default_factory=dict, repr=False)

    def of(self, selection: Selection) -> HeldOutPredictor:
        """The same with another result of the search."""
        # gaps that are known depend on the evidence that fits the values, not on the terms chosen
        same = selection.evidence is self.selection.evidence
        return replace(self, selection=selection, _gaps=self._gaps if same else {})

    @property
    def segments(self) -> list[Segment]:
        """The segments that are predicted."""
        return self.set_aside or [segment for fold in self.folds for segment in fold]

    def gap(self, terms: frozenset[Term]) -> TorqueGap:
        """Torque gap on held-out data of the nominal arm plus some of the terms, fitted anew."""
        if terms not in self._gaps:
            self._gaps[terms] = self.measured(
                terms, lambda arm, segments: torque_gap(arm, self.body, segments)
            )
        return self._gaps[terms]

    def measured(self, terms: frozenset[Term], gap_of: GapOf) -> TorqueGap:
        """Any gap on held-out data of the nominal arm plus some of the terms, fitted anew."""
        evidence = self.selection.evidence

        # Recordings that are never fitted are held out as they are: no fold has to be left out.
        if self.set_aside:
            corrected = self.selection.corrected(evidence.fit(terms).theta, terms)
            return gap_of(corrected, self.set_aside)

        gaps = []
        for values, fold in zip(evidence.left_out(terms), self.folds, strict=True):
            # The whole fold is predicted twice, as effects with a state need what came before.
            without_first = self.selection.corrected(values[0], terms)
            without_second = self.selection.corrected(values[1], terms)
            joined = join_halves(
                gap_of(without_first, fold), gap_of(without_second, fold)
            )
            gaps.append(joined)
        return _concatenated(gaps)

    def shares(self, draws: int = SHARE_DRAWS) -> dict[str, Share]:
        """Share of each effect in the gap closed, by Shapley's value over all orders of adding them.

        The worth of a set is the sum over joints of the held-out torque NRMSE that it closes; shares add up to the
        closed part of the gap above the floor, at most 1. Intervals are from folds drawn with replacement.
        """
        evidence, chosen = self.selection.evidence, self.selection.fit.terms
        names = sorted({t.finding for t in chosen})
        weights = _fold_weights(evidence.rows, draws)

        def total_nrmse(square: np.ndarray) -> np.ndarray:
            """NRMSE summed over joints, under each draw, (draws + 1,), of mean squares per fold and joint, (F, n)."""
            rows = np.maximum(weights.sum(axis=1), 1e-12)
            mean = (square * weights).sum(axis=1) / rows
            nrmse = np.sqrt(mean) / self.selection.scale
            return np.asarray(nrmse.sum(axis=1))

        worth = {}
        for subset in _subsets(names):
            terms = frozenset(t for t in chosen if t.finding in subset)
            mean_square = evidence.held_out_mse(terms, corrected=False)
            worth[subset] = -total_nrmse(mean_square)

        closed = worth[tuple(names)] - worth[()]
        above_floor = -worth[()] - total_nrmse(evidence.floor2)

        # Effects may close more than lies above an estimated floor: then they share what they close.
        whole = np.maximum(above_floor, closed)
        whole = np.maximum(whole, 1e-12)

        shares = {}
        for name in names:
            value = shapley_value(name, names, worth)
            shares[name] = Share.of(value / whole)
        return shares


@dataclass(frozen=True)
class Share:
    """An effect's share of the gap above the floor, and the interval that holds nine of ten draws of the folds."""

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, draws: np.ndarray) -> Share:
        """The share of the first draw, and the interval of the others; all within 0 and 1."""
        inside = np.clip(draws, 0.0, 1.0)
        low, high = np.quantile(inside[1:], [0.05, 0.95])
        return cls(float(inside[0]), float(low), float(high))


def shapley_value(
    name: str, names: list[str], worth: dict[tuple[str, ...], np.ndarray]
) -> np.ndarray:
    """Shapley's value of one of the names, given the worth of every subset in sorted order.

    phi_i = sum over S without i of |S|! (n - |S| - 1)! / n! (v(S + i) - v(S))
    """
    others = [n for n in names if n != name]
    orders = factorial(len(names))
    total = np.zeros_like(worth[()])
    for subset in _subsets(others):
        # Orders of adding that have the subset before the name, and the rest after it.
        before = factorial(len(subset))
        after = factorial(len(others) - len(subset))
        joined = tuple(sorted((*subset, name)))
        added = worth[joined] - worth[subset]
        total += before * after / orders * added
    return total


def join_halves(first: TorqueGap, second: TorqueGap) -> TorqueGap:
    """The first half of one gap and the second half of another on the same samples."""
    middle = len(first.measured) // 2
    measured = np.vstack([first.measured[:middle], second.measured[middle:]])
    predicted = np.vstack([first.predicted[:middle], second.predicted[middle:]])
    return TorqueGap(measured, predicted, first.edges)


def _concatenated(gaps: list[TorqueGap]) -> TorqueGap:
    """Gaps of several folds as one."""
    edges = [0]
    for gap in gaps:
        start = edges[-1]
        edges += [start + edge for edge in gap.edges[1:]]
    return TorqueGap(
        measured=np.vstack([gap.measured for gap in gaps]),
        predicted=np.vstack([gap.predicted for gap in gaps]),
        edges=tuple(edges),
    )


def _subsets(names: list[str]) -> list[tuple[str, ...]]:
    """All subsets of names, in their order, the empty one first."""
    sizes = range(len(names) + 1)
    return [subset for size in sizes for subset in combinations(names, size)]


def _fold_weights(rows: np.ndarray, draws: int) -> np.ndarray:
    """Rows of each fold, (F, n), as often as each draw holds it; the first draw holds each once: (draws + 1, F, n)."""
    folds = len(rows)
    chance = np.full(folds, 1 / folds)
    # A fixed seed: the same case has the same intervals.
    counts = np.random.default_rng(0).multinomial(folds, chance, size=draws)

    once = np.ones(folds)
    held = np.vstack([once, counts])
    return np.asarray(held[:, :, None] * rows)
