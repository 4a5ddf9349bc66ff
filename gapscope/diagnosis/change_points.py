"""Whether a quantity that was estimated at several dates has changed, and between which two of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr, owens_t
from scipy.stats import chi2

from gapscope.diagnosis.thresholds import MIN_DIFFERENCES, SHORTEST_HISTORY

MEDIAN_CHI2 = float(chi2.median(1))
"""Median of the chi-squared distribution with one degree of freedom [1]."""


@dataclass(frozen=True)
class ChangePoint:
    """The most likely change of a mean in a sequence of n estimates x_i with standard deviations s_i.

    With weights w_i = 1 / s_i^2, W_k = sum_{i <= k} w_i and the weighted means m_k before and m'_k after k,

        Z_k = (m'_k - m_k) / sqrt(1 / W_k + 1 / (W_n - W_k)),        k = 1 .. n - 1.

    Each Z_k is a standard normal variable if nothing has changed; the change is where |Z_k| is largest [hawkins1977].

    Attributes:
        position: number k of estimates before the change.
        before: weighted mean before it, in the unit of the estimates.
        after: weighted mean after it.
        before_std: standard deviation of ``before``.
        after_std: standard deviation of ``after``.
        z: Z_k, with the sign of ``after - before`` [1].
        p: upper bound of the probability that a sequence without a change has a |Z_k| as large [1].
    """

    position: int
    before: float
    after: float
    before_std: float
    after_std: float
    z: float
    p: float


def change_point(values: np.ndarray, stds: np.ndarray) -> ChangePoint:
    """The most likely change in a sequence of estimates.

    Args:
        values: x_i in the order of time, (n,), n at least 2.
        stds: s_i > 0, (n,).
    """
    # relative to their mean and to the least deviation: no overflow, no loss of digits
    unit, origin = stds.min(), values.mean()
    weights = (unit / stds) ** 2
    # sums up to each k: weighted means before and after it follow at once
    left = np.cumsum(weights)
    sums = np.cumsum(weights * (values - origin) / unit)
    total = left[-1]
    right = total - left[:-1]
    before = sums[:-1] / left[:-1]
    after = (sums[-1] - sums[:-1]) / right
    z = (after - before) / np.sqrt(1 / left[:-1] + 1 / right)
    k = int(np.abs(z).argmax())
    return ChangePoint(
        position=k + 1,
        before=float(origin + unit * before[k]),
        after=float(origin + unit * after[k]),
        before_std=float(unit / np.sqrt(left[k])),
        after_std=float(unit / np.sqrt(right[k])),
        z=float(z[k]),
        p=_exceedance(abs(float(z[k])), left[:-1] / total),
    )


def change_points(
    values: np.ndarray, stds: np.ndarray, level: float
) -> tuple[ChangePoint, ...]:
    """All changes, by binary segmentation: each part is tested again by itself [vostrikova1981].

    Args:
        values: x_i in the order of time, (n,).
        stds: s_i > 0, (n,).
        level: greatest probability of a change in a part that has none [1].

    Returns:
        The changes in the order of time; means are those of the part that was tested.
    """
    if len(values) < SHORTEST_HISTORY:
        return ()
    found = change_point(values, stds)
    if found.p > level:
        return ()
    # both sides of a change may hold further ones
    k = found.position
    earlier = change_points(values[:k], stds[:k], level)
    later = change_points(values[k:], stds[k:], level)
    # places count from the beginning of the whole
    moved = (replace(change, position=change.position + k) for change in later)
    return (*earlier, found, *moved)


def _exceedance(bound: float, fractions: np.ndarray) -> float:
    """Upper bound of the probability that the largest of |Z_1| .. |Z_{n-1}| reaches a bound b.

    sum_k P(A_k) - sum_k P(A_k and A_{k+1}), A_k: |Z_k| >= b [worsley1982]. Z_j and Z_k, j < k, have the correlation
    sqrt(u_j (1 - u_k) / (u_k (1 - u_j))), u_k = W_k / W_n. Of normal variables X, Y with correlation r,
    P(X > b and Y > b) = Phi(-b) - 2 T(b, sqrt((1 - r) / (1 + r))), T: Owen's function.

    Args:
        bound: b.
        fractions: u_k, (n - 1,).
    """
    # beyond on either side
    each = 2 * ndtr(-bound)
    u, following = fractions[:-1], fractions[1:]
    correlation = np.sqrt(u * (1 - following) / (following * (1 - u)))
    both = 0.0
    # both on one side, or on opposite ones, which is a correlation of -r
    for r in (correlation, -correlation):
        above = ndtr(-bound) - 2 * owens_t(bound, np.sqrt((1 - r) / (1 + r)))
        both += 2 * float(above.sum())
    return float(np.clip(len(fractions) * each - both, 0.0, 1.0))


def appearance(found: Sequence[bool]) -> ChangePoint:
    """Whether an effect is found more often after some date than before.

    Of n diagnoses in the order of time m name the effect, S_k of the first k. Without a change every order of the m
    among the n is as likely; then S_k has mean k m / n and a known variance, and Z_k = (S_k - k m / n) / std(S_k).

    Args:
        found: whether each diagnosis names the effect, (n,).

    Returns:
        The most likely change of the share that names it, whose p is the exact probability that a random order has a
        |Z_k| as large; 1 if all or none name it. Shares have no deviation.
    """
    n, m = len(found), sum(found)
    if n < SHORTEST_HISTORY or m in (0, n):
        return ChangePoint(0, m / n, m / n, 0.0, 0.0, 0.0, 1.0)
    k, before = np.arange(1, n), np.cumsum(found)[:-1]
    # S_k is hypergeometric
    std = np.sqrt(m * (n - m) * k * (n - k) / (n**2 * (n - 1)))
    z = (before - k * m / n) / std
    best = int(np.abs(z).argmax())
    position, count = best + 1, int(before[best])
    earlier, later = count / position, (m - count) / (n - position)
    p = _random_order(n, m, std * abs(z[best]))
    return ChangePoint(position, earlier, later, 0.0, 0.0, -float(z[best]), p)


def _random_order(n: int, m: int, distance: np.ndarray) -> float:
    """Share of the orders of m among n in which some |S_k - k m / n| reaches its distance, (n - 1,)."""
    counts = np.arange(m + 1)
    # how likely each count is, of orders that have stayed within all distances
    inside: np.ndarray = np.zeros(m + 1)
    inside[0] = 1.0
    for k in range(1, n + 1):
        # the k-th is one of those left: with this probability one that names the effect
        named = inside * (m - counts) / (n - k + 1)
        unnamed = inside - named
        unnamed[1:] += named[:-1]
        inside = unnamed
        if k < n:
            # rounding does not turn a tie into a miss
            inside[np.abs(counts - k * m / n) >= distance[k - 1] - 1e-9] = 0.0
    return float(min(1.0, max(0.0, 1.0 - inside.sum())))


def scatter(histories: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    """Factor by which estimates of unchanged quantities scatter more than their standard deviations say.

    From the differences d of successive estimates of each unit, d^2 / (s_i^2 + s_{i+1}^2) is chi-squared with one
    degree of freedom; the median of all of them does not notice the few that hold a change.

    Args:
        histories: values and standard deviations of each unit in the order of time.

    Returns:
        The factor [1]: at least one, and one if there are fewer than ``MIN_DIFFERENCES`` differences.
    """
    squares = [
        np.diff(values) ** 2 / (stds[:-1] ** 2 + stds[1:] ** 2)
        for values, stds in histories
    ]
    ratios = np.concatenate(squares) if squares else np.empty(0)
    if len(ratios) < MIN_DIFFERENCES:
        return 1.0
    return float(max(1.0, np.sqrt(np.median(ratios) / MEDIAN_CHI2)))
