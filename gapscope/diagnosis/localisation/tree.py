"""A shallow regression tree over a few quantities [breiman1984]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.thresholds import LEAF_ROWS

BINS = 48
"""Thresholds that are tried per quantity, at equal shares of the rows."""


@dataclass(frozen=True)
class Cut:
    """One condition: the quantity with this index lies above ``threshold``, or else not."""

    index: int
    threshold: float
    above: bool

    def holds(self, x: np.ndarray) -> np.ndarray:
        """Mask over rows x of shape (M, K); shape (M,)."""
        higher = x[:, self.index] > self.threshold
        return higher if self.above else ~higher


def hottest_leaf(x: np.ndarray, y: np.ndarray, depth: int) -> tuple[Cut, ...]:
    """The cuts that lead to the leaf with the largest mean of y; empty if no cut is worth anything.

    At each node the cut with the largest fall of the sum of squares n1 n2 / n (mean1 - mean2)^2 is made, and the hotter
    side is followed: a tree of which one branch is grown.

    Args:
        x: quantities, shape (M, K).
        y: what is predicted, shape (M,).
        depth: most cuts.
    """
    cuts: list[Cut] = []
    inside = np.ones(len(y), dtype=bool)
    least = max(4, int(LEAF_ROWS * len(y)))
    for _ in range(depth):
        cut = _best_cut(x[inside], y[inside], least)
        if cut is None:
            break
        cuts.append(cut)
        inside &= cut.holds(x)
    return tuple(cuts)


def _best_cut(x: np.ndarray, y: np.ndarray, least: int) -> Cut | None:
    """The cut with the largest fall of the sum of squares; ``None`` if no cut leaves ``least`` rows on both sides."""
    if len(y) <= 2 * least:
        return None
    counts = np.unique(np.linspace(least, len(y) - least, BINS).astype(int))
    largest_fall, best = 0.0, None
    for index, values in enumerate(x.T):
        order = np.argsort(values, kind="stable")
        ordered, total = values[order], np.cumsum(y[order])
        for below in counts:
            low_value, high_value = ordered[below - 1], ordered[below]
            if low_value == high_value:
                continue  # no threshold lies between equal values
            above = len(y) - below
            low_mean = total[below - 1] / below
            high_mean = (total[-1] - total[below - 1]) / above
            fall = below * above / len(y) * (high_mean - low_mean) ** 2
            if fall > largest_fall:
                threshold = float(0.5 * (low_value + high_value))
                largest_fall = fall
                best = Cut(index, threshold, bool(high_mean > low_mean))
    return best
