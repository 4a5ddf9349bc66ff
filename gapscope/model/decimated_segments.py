"""Segments and the rows that are taken of them: filtered, trimmed, decimated to about twice the filter's cut-off."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gapscope.model.body_point import Bodies
from gapscope.model.conditioning import Segment
from gapscope.model.decimating_filter import low_passed_rows

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
