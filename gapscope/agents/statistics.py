"""Means over few runs that outliers do not carry away, with bootstrap intervals."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from math import nan
from typing import NamedTuple

import numpy as np

LEVEL = 0.95
"""Coverage of the intervals [1]."""
DRAWS = 2000
"""Bootstrap draws."""


class Mean(NamedTuple):
    """An interquartile mean with its interval, in the unit of the values; infinite if too many runs diverged."""

    value: float
    low: float
    high: float


def interquartile_mean(values: np.ndarray) -> np.ndarray:
    """Mean of the middle half of the values along the first axis, shape (N, ...).

    A quarter of the N values, rounded down, is left out at both ends; below four values it is the plain mean. Infinite
    values count as the largest.

    Source: agarwal2021.
    """
    ranked = np.sort(np.asarray(values, dtype=float), axis=0)
    cut = len(ranked) // 4
    return np.asarray(ranked[cut : len(ranked) - cut].mean(axis=0))


def mean_of(
    values: Sequence[float],
    strata: Sequence[Hashable],
    rng: np.random.Generator,
    draws: int = DRAWS,
) -> Mean:
    """Interquartile mean with the percentile interval of a stratified bootstrap.

    Runs are drawn with replacement within each stratum, so that every motion keeps its weight (agarwal2021). With
    one run per stratum the interval is the value.

    Args:
        values: of the runs.
        strata: what they are drawn within, one per value, such as the motion.
        rng: source of the draws.
        draws: how many.
    """
    if not len(values):
        return Mean(nan, nan, nan)
    array = np.asarray(values, dtype=float)
    groups: dict[Hashable, list[int]] = {}
    for place, stratum in enumerate(strata):
        groups.setdefault(stratum, []).append(place)
    rows = [
        np.asarray(group)[rng.integers(len(group), size=(len(group), draws))]
        for group in groups.values()
    ]
    resampled = interquartile_mean(array[np.concatenate(rows)])
    low, high = np.quantile(
        resampled, [(1 - LEVEL) / 2, (1 + LEVEL) / 2], method="nearest"
    )
    return Mean(float(interquartile_mean(array)), float(low), float(high))


def rank_correlation(x: Sequence[float], y: Sequence[float]) -> float | None:
    """Spearman's rank correlation [1], or ``None`` if there are fewer than three values or all are equal."""
    if len(x) < 3:
        return None
    a, b = (
        np.argsort(np.argsort(np.asarray(v, dtype=float))).astype(float) for v in (x, y)
    )
    if np.ptp(np.asarray(x)) == 0 or np.ptp(np.asarray(y)) == 0:
        return None
    return float(np.corrcoef(a, b)[0, 1])
