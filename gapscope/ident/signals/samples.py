"""The samples of the pipeline: segments with torque, both sides of tau = W x through the same filter."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.motions.motion import Motion
from gapscope.arm.recording import Recording
from gapscope.ident.model.friction_law import FrictionLaw
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.model_columns import ModelColumns
from gapscope.model.conditioning import Segment, blocks, condition, low_pass
from gapscope.model.decimating_filter import low_passed_rows

PER_CUTOFF = 4.0
"""Samples per period of the cut-off that are kept to fit; more hold no further information."""
MOST = 20_000
"""Samples that are kept at most: long recordings are thinned further, which bounds the memory."""
LONGEST = 60.0
"""Longer segments are worked on in blocks of at most this [s]."""


@dataclass(frozen=True)
class Band:
    """The band in which both sides are compared.

    Attributes:
        cutoff: of positions, columns and torque [Hz].
        trim: whether both ends of a segment, where the filter settles, are left out.
        thinning: by which factor fewer samples are kept than the band holds [1].
    """

    cutoff: float
    trim: bool = True
    thinning: int = 1

    def bounded(self, segments: Sequence[Segment], most: int = MOST) -> Band:
        """The band that keeps no more than about ``most`` samples of these segments."""
        plain = replace(self, thinning=1)
        count = sum(len(s.motion.t) / plain.step(s) for s in segments)
        return replace(self, thinning=max(1, int(np.ceil(count / most))))

    def filtered(self, series: np.ndarray, segment: Segment) -> np.ndarray:
        """A series of a segment in the band, trimmed; axis 0 is time."""
        rows = self.rows(segment)
        # a joint's torque has nothing of the bodies before it: half of a regressor is zero, filtered or not
        present = series.any(axis=0)
        if series.ndim == 1 or present.all():
            return low_pass(series, segment.motion.rate, self.cutoff)[rows]
        out = np.zeros_like(series[rows])
        some = series[:, present]
        out[:, present] = low_pass(some, segment.motion.rate, self.cutoff)[rows]
        return out

    def thinned(self, series: np.ndarray, segment: Segment) -> np.ndarray:
        """The same at every ``step``-th of these samples, at a fraction of the cost; in arrays of its own."""
        rows, flat = self.rows(segment), series.reshape(len(series), -1)
        kept = slice(rows.start, rows.stop, self.step(segment))
        present = flat.any(axis=0)
        some = low_passed_rows(flat[:, present], segment.motion.rate, self.cutoff, kept)
        out = np.zeros((len(some), flat.shape[1]))
        out[:, present] = some
        return out.reshape(len(some), *series.shape[1:])

    def rows(self, segment: Segment) -> slice:
        """The samples of a segment that count."""
        return segment.inner if self.trim else slice(0, len(segment.motion.t))

    def step(self, segment: Segment) -> int:
        """Every which sample is kept to fit."""
        within_band = int(segment.motion.rate / (PER_CUTOFF * self.cutoff) + 1e-6)
        return self.thinning * max(1, within_band)

    def segments(self, recordings: Sequence[Recording]) -> list[Segment]:
        """Segments of recordings, positions filtered at the cut-off; those without torque are left out.

        Long ones are cut into blocks, whose trimmed samples follow each other without a gap.
        """
        # recordings without torque cannot be compared
        whole: list[Segment] = []
        for recording in recordings:
            if recording.tau is not None:
                whole += condition(recording, self.cutoff)
        if not self.trim:
            return whole
        cut: list[Segment] = []
        for segment in whole:
            cut += blocks(segment, _count(segment))
        return cut


def _count(segment: Segment) -> int:
    """Number of blocks of a segment."""
    return int(np.ceil(len(segment.motion.t) / segment.motion.rate / LONGEST))


class Samples:
    """Samples to fit, stacked over segments and thinned to what the band holds.

    Columns at the full rate are held of one segment at a time. Where a torque was not measured, both sides of its
    equation are zero: it says nothing.

    Args:
        columns: the model.
        segments: with torque.
        band: the band.

    Attributes:
        smooth: columns that do not depend on the friction law, in the band, shape (M, n, p_smooth).
        torque: recorded torque in the band, less that of known loads [N m], shape (M, n).
        velocity: dq [rad/s], shape (M, n).
        measured: whether the torque was measured there, shape (M, n): see ``Segment.unknown``.
        times: of the recording that a sample belongs to [s], shape (M,).
        group: number of the segment of each sample, shape (M,).
        interval: time between samples [s].
    """

    def __init__(
        self, columns: ModelColumns, segments: Sequence[Segment], band: Band
    ) -> None:
        self.columns = columns
        self.segments = list(segments)
        self.band = band
        times, velocities, measured = [], [], []
        for segment in self.segments:
            rows, step = band.rows(segment), band.step(segment)
            times.append(segment.motion.t[rows][::step])
            velocities.append(segment.motion.dq[rows][::step])
            measured.append(segment.measured[rows][::step])
        self.times = np.concatenate(times)
        self.velocity = np.concatenate(velocities)
        self.measured = np.concatenate(measured)
        self.smooth = self.filtered_each(columns.smooth)
        self.torque = self._stack(
            np.asarray(s.torque) - s.known_torque(columns.body) for s in self.segments
        )
        lengths = [len(t) for t in times]
        self.group = np.repeat(np.arange(len(lengths)), lengths)
        first = self.segments[0]
        self.interval = band.step(first) / first.motion.rate

    def matrix(self, law: FrictionLaw) -> np.ndarray:
        """W in the band, shape (M, n, p)."""
        dry = self.filtered_each(lambda motion: self.columns.dry(motion, law))
        return np.concatenate([self.smooth, dry], axis=2)

    def problem(
        self, law: FrictionLaw, kept: np.ndarray, names: Sequence[str]
    ) -> Problem:
        """The linear problem in the columns ``kept``."""
        return Problem(
            self.matrix(law)[:, :, kept],
            self.torque,
            tuple(names),
            self.group,
            self.interval,
        )

    def filtered_each(self, series: Callable[[Motion], np.ndarray]) -> np.ndarray:
        """A function of the motion, (N, n, ...), in the band and thinned; shape (M, n, ...)."""
        return self._stack(series(s.motion) for s in self.segments)

    def _stack(self, series: Iterable[np.ndarray]) -> np.ndarray:
        pairs = zip(series, self.segments, strict=True)
        stacked = np.concatenate([self.band.thinned(x, s) for x, s in pairs])
        stacked[~self.measured] = 0.0
        return stacked
