"""Segments on decimated rows, and the filter that decimates them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from gapscope.model.body_point import Bodies
from gapscope.model.conditioning import Segment, low_pass

# The zero-phase low-pass on every so many samples only, as products of small matrices.
#
# ``conditioning.low_pass`` is linear: row i of what it gives is a sum over the samples about it, since its response
# fades within a few periods of the cut-off. What is kept of a long series is therefore a product with a narrow band,
# the same for all rows away from the ends; near the ends the rows are those of a short series. To keep one row of
# four costs a third of filtering all of them.


FADED = 9.0
"""Periods of the cut-off after which the response has faded to 1e-9 of its peak [1]."""
MAX_OF_RATE = 0.25
"""Cut-off over rate up to which this holds [1]."""
BLOCK = 16
"""Rows that are computed by one product."""


def low_passed_rows(
    series: np.ndarray, rate: float, cutoff: float, kept: slice
) -> np.ndarray:
    """``low_pass(series, rate, cutoff)[kept]`` to 1e-8 of its size.

    Args:
        series: samples, (N, C).
        rate: of the samples [Hz].
        cutoff: of the low-pass [Hz].
        kept: which rows of the result are wanted; M of them.

    Returns:
        Shape (M, C).
    """
    count = len(series)
    rows = np.arange(count)[kept]
    step = 1 if kept.step is None else kept.step
    # of all rows the recursion is cheaper, and near Nyquist its response fades slowly
    if step == 1 or cutoff > MAX_OF_RATE * rate:
        return low_pass(series, rate, cutoff)[kept]
    # stamps give rates that differ by rounding from recording to recording
    rate = round(rate, 6)
    length = min(count, 4 * _reach(rate, cutoff))
    short = _short_series(rate, cutoff, length)
    if length == count:
        return np.asarray(short[rows] @ series)
    out = np.empty((len(rows), series.shape[1]))
    beginning, end = rows < length // 2, rows >= count - length // 2
    out[beginning] = short[rows[beginning]] @ series[:length]
    out[end] = short[rows[end] - (count - length)] @ series[count - length :]
    between = np.flatnonzero(~(beginning | end))
    reach, band = length // 4, _band(rate, cutoff, step)
    for block in np.split(between, range(BLOCK, len(between), BLOCK)):
        if len(block):
            first, last = rows[block[0]] - reach, rows[block[-1]] + reach + 1
            out[block] = band[: len(block), : last - first] @ series[first:last]
    return out


def _reach(rate: float, cutoff: float) -> int:
    """Samples after which the response has faded."""
    return int(np.ceil(FADED * rate / cutoff))


@lru_cache(maxsize=16)
def _band(rate: float, cutoff: float, step: int) -> np.ndarray:
    """The response in the middle of a series, moved on by ``step`` samples from row to row of a block."""
    reach = _reach(rate, cutoff)
    response = _short_series(rate, cutoff, 4 * reach)[2 * reach, reach : 3 * reach + 1]
    band = np.zeros((BLOCK, len(response) + (BLOCK - 1) * step))
    for row, own in enumerate(band):
        own[row * step : row * step + len(response)] = response
    return band


@lru_cache(maxsize=16)
def _short_series(rate: float, cutoff: float, length: int) -> np.ndarray:
    """What the low-pass makes of each sample of a series, (L, L)."""
    return low_pass(np.eye(length), rate, cutoff)


# Segments and the rows that are taken of them: filtered, trimmed, decimated to about twice the filter's cut-off.


UNMEASURED = 1e-3
"""Weight of a row whose torque was not measured [1]: not zero, as each half of a recording needs some rows."""


class DecimatedSegments:
    """Segments, and their series on decimated rows.

    Attributes:
        segments: the segments.
        cutoff: cut-off of the filter [Hz].
        bodies: what the columns need of each segment's bodies.
    """

    bodies: list[Bodies]

    def __init__(self, segments: list[Segment], cutoff: float) -> None:
        self.segments, self.cutoff = segments, cutoff

    def thin(self, series: np.ndarray, segment: Segment) -> np.ndarray:
        """Series of a segment, filtered, trimmed, and decimated to about twice the filter's cut-off."""
        inner, rate = segment.inner, segment.motion.rate
        kept = slice(inner.start, inner.stop, self.step(segment))
        flat = series.reshape(len(series), -1)
        rows = low_passed_rows(flat, rate, self.cutoff, kept)
        return rows.reshape(len(rows), *series.shape[1:])

    def known(self, segment: Segment) -> np.ndarray:
        """Weight of a segment's rows by whether their torque was measured, (M, n): 1, or ``UNMEASURED``."""
        inner = segment.inner
        kept = slice(inner.start, inner.stop, self.step(segment))
        return np.where(segment.measured[kept], 1.0, UNMEASURED)

    def rows(self, series: Sequence[np.ndarray]) -> np.ndarray:
        """Series of every segment, (N, K) each, on its rows, one below the other, (M, K)."""
        pairs = zip(series, self.segments, strict=True)
        return np.vstack([self.thin(x, s) for x, s in pairs])

    def step(self, segment: Segment) -> int:
        """Every how many samples the rows are taken."""
        return max(1, int(segment.motion.rate // (2.5 * self.cutoff)))

    def time(self, segment: Segment) -> np.ndarray:
        """Time of a segment's rows since the start of its recording [s], (M,)."""
        inner = segment.inner
        return segment.motion.t[inner.start : inner.stop : self.step(segment)]
