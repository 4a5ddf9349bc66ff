"""The arm's own repeatability: what its torque differs by when it makes the same motion again.

No model that goes by the motion predicts better than that, so it is a floor that nobody assumed. Two stretches are the
same motion if the torque predicted along them differs by no more than the noise floor on any joint: then the model is
asked the same twice. What the two gaps differ by, over sqrt 2, is what one of them has that does not repeat.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from scipy.signal import correlate

from gapscope.model.conditioning import torque_scale
from gapscope.model.torque_gap import TorqueGap


@dataclass(frozen=True)
class Repeatability:
    """What does not repeat, n joints.

    Attributes:
        rms: of the torque [N m], (n,).
        seconds: length of what was made again [s].
    """

    rms: np.ndarray
    seconds: float


def repeatability(
    gap: TorqueGap, edges: Sequence[int], rates: Sequence[float], floor: np.ndarray
) -> Repeatability | None:
    """What does not repeat of a gap; ``None`` if no motion was made twice.

    Args:
        gap: of the arm that predicts best.
        edges: row at which each of its segments begins, and the end.
        rates: of the segments [Hz].
        floor: RMS that a healthy arm leaves [N m], (n,).
    """
    scale = torque_scale(gap.measured)
    squares, rows, seconds = np.zeros(len(scale)), 0, 0.0
    # each segment with itself as well: a motion may come twice in one
    for a, b in combinations_with_replacement(range(len(edges) - 1), 2):
        # rows are of the same moments if clocks part by less than half a row; stamps give no two rates alike
        count = min(edges[a + 1] - edges[a], edges[b + 1] - edges[b])
        if 2 * count * abs(rates[a] - rates[b]) > rates[a]:
            continue
        first, second = (slice(edges[k], edges[k + 1]) for k in (a, b))
        for lag in _lags(
            gap.predicted[first] / scale, gap.predicted[second] / scale, a == b
        ):
            one, other = _overlap(first, second, lag)
            apart = gap.predicted[one] - gap.predicted[other]
            # on no joint may the model be asked something else
            if (np.sqrt((apart**2).mean(axis=0)) > floor).any():
                continue
            change = gap.error[one] - gap.error[other]
            # a difference of two gaps has twice the variance of one
            squares += (change**2).sum(axis=0) / 2.0
            rows += len(change)
            seconds += len(change) / rates[a]
    return Repeatability(np.sqrt(squares / rows), seconds) if rows else None


def _lags(first: np.ndarray, second: np.ndarray, same: bool) -> Iterator[int]:
    """The shift of the second series that matches the first one best, over half of the shorter one at least.

    Of a series and itself a shift beyond that at which it no longer resembles itself.
    """
    count = min(len(first), len(second))
    shifts = np.arange(-(len(second) - 1), len(first))
    ones = [np.ones(len(x)) for x in (first, second)]
    # how many rows overlap at each shift
    rows = np.round(correlate(ones[0], ones[1], method="fft"))
    # sum of (x - y)^2 over what overlaps, for all shifts at once
    squares = sum(
        correlate(x**2, ones[1], method="fft")
        + correlate(ones[0], y**2, method="fft")
        - 2.0 * correlate(x, y, method="fft")
        for x, y in zip(first.T, second.T, strict=True)
    )
    # a short overlap matches by chance
    apart = np.where(rows >= count / 2, squares / np.maximum(rows, 1.0), np.inf)
    if same:
        # of unlike series the squares are twice the variance of all joints, which are of unit size
        unlike = np.flatnonzero((shifts > 0) & (apart > first.var(axis=0).sum()))
        if not len(unlike):
            return
        # negative shifts go with it: they are the same pairs
        apart[: unlike[0]] = np.inf
    if np.isfinite(apart).any():
        yield int(shifts[int(apart.argmin())])


def _overlap(first: slice, second: slice, shift: int) -> tuple[slice, slice]:
    """Rows of both where the second begins ``shift`` rows after the first."""
    start = max(0, shift)
    end = min(first.stop - first.start, second.stop - second.start + shift)
    return (
        slice(first.start + start, first.start + end),
        slice(second.start + start - shift, second.start + end - shift),
    )
