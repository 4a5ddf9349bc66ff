"""Means over few runs that outliers do not carry away, with bootstrap intervals."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from math import nan
from typing import NamedTuple

import numpy as np
from scipy.stats import spearmanr, trim_mean

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
    return np.asarray(trim_mean(np.asarray(values, dtype=float), 0.25, axis=0))


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
    places_of: dict[Hashable, list[int]] = {}
    for place, stratum in enumerate(strata):
        places_of.setdefault(stratum, []).append(place)
    drawn = []
    for places in places_of.values():
        count = len(places)
        drawn.append(np.array(places)[rng.integers(count, size=(count, draws))])
    resampled = interquartile_mean(array[np.concatenate(drawn)])
    tails = [(1 - LEVEL) / 2, (1 + LEVEL) / 2]
    # a value that was drawn: infinite ones cannot be interpolated
    low, high = np.quantile(resampled, tails, method="nearest")
    return Mean(float(interquartile_mean(array)), float(low), float(high))


def rank_correlation(x: Sequence[float], y: Sequence[float]) -> float | None:
    """Spearman's rank correlation [1], or ``None`` if there are fewer than three values or all are equal."""
    if len(x) < 3 or len(set(x)) == 1 or len(set(y)) == 1:
        return None
    return float(spearmanr(x, y).statistic)
