"""Samples of an identification: filtered, split, and as many as they are worth."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import periodogram

from gapscope.arm.case import Case
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.recording import Recording
from gapscope.ident.model.base_parameters import TINY
from gapscope.ident.model.linear_problem import FrictionLaw, ModelColumns, Problem
from gapscope.model.conditioning import Segment, blocks, condition, low_pass
from gapscope.model.effective_samples import band_samples, group_slices
from gapscope.model.rows import low_passed_rows

# The samples of the pipeline: segments with torque, both sides of tau = W x through the same filter.


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
        return low_pass(series, segment.motion.rate, self.cutoff)[self.rows(segment)]

    def thinned(self, series: np.ndarray, segment: Segment) -> np.ndarray:
        """The same at every ``step``-th of these samples, at a fraction of the cost; in arrays of its own."""
        flat, kept = series.reshape(len(series), -1), self.kept(segment)
        present = flat.any(axis=0)
        some = low_passed_rows(flat[:, present], segment.motion.rate, self.cutoff, kept)
        out = np.zeros((len(some), flat.shape[1]))
        out[:, present] = some
        return out.reshape(len(some), *series.shape[1:])

    def rows(self, segment: Segment) -> slice:
        """The samples of a segment that count."""
        return segment.inner if self.trim else slice(0, len(segment.motion.t))

    def kept(self, segment: Segment) -> slice:
        """Those of them that are kept to fit."""
        rows = self.rows(segment)
        return slice(rows.start, rows.stop, self.step(segment))

    def step(self, segment: Segment) -> int:
        """Every which sample is kept to fit."""
        within_band = int(segment.motion.rate / (PER_CUTOFF * self.cutoff) + 1e-6)
        return self.thinning * max(1, within_band)

    def segments(self, recordings: Sequence[Recording]) -> list[Segment]:
        """Segments of recordings, positions filtered at the cut-off; those without torque are left out.

        Long ones are cut into blocks, whose trimmed samples follow each other without a gap.
        """
        # recordings without torque cannot be compared
        known = [r for r in recordings if r.tau is not None]
        whole = [s for r in known for s in condition(r, self.cutoff)]
        if not self.trim:
            return whole
        seconds = [len(s.motion.t) / s.motion.rate for s in whole]
        counts = [int(np.ceil(length / LONGEST)) for length in seconds]
        pairs = zip(whole, counts, strict=True)
        return [part for s, count in pairs for part in blocks(s, count)]


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
        kept = [(s, band.kept(s)) for s in self.segments]
        self.times = np.concatenate([s.motion.t[rows] for s, rows in kept])
        self.velocity = np.concatenate([s.motion.dq[rows] for s, rows in kept])
        self.measured = np.concatenate([s.measured[rows] for s, rows in kept])
        self.smooth = self.filtered_each(columns.smooth)
        self.torque = self._stack(
            np.asarray(s.torque) - s.known_torque(columns.body) for s in self.segments
        )
        lengths = [len(s.motion.t[rows]) for s, rows in kept]
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


# How many independent samples a motion gives for each parameter.


ADVISED = 10.0
"""Independent samples per base parameter below which there is a warning [1]."""
POWER = 0.99
"""Share of the torque's power that lies within its bandwidth [1]."""


@dataclass(frozen=True)
class SampleCount:
    """How much information the fitted recordings hold.

    Attributes:
        seconds: length of the fitted samples [s].
        bandwidth: frequency below which ``POWER`` of the torque's power about its mean lies [Hz], shape (n,).
        independent: sum_j 2 B_j T, the independent samples of all joints [1].
        parameters: number of base parameters.
    """

    seconds: float
    bandwidth: np.ndarray
    independent: float
    parameters: int

    @property
    def per_parameter(self) -> float:
        """Independent samples per base parameter [1]."""
        return self.independent / self.parameters

    def warnings(self, *, model_error: bool) -> tuple[str, ...]:
        """A warning if there are fewer than ``ADVISED`` per parameter, or none.

        Args:
            model_error: whether the residual follows the motion; then faster motion only hides what the model lacks.
        """
        if self.per_parameter >= ADVISED:
            return ()
        needed = self.seconds * ADVISED / self.per_parameter
        faster = "" if model_error else ", or move faster"
        return (
            f"{self.seconds:.3g} s of motion up to {self.bandwidth.max():.2g} Hz hold about {self.per_parameter:.1f} "
            f"independent samples per base parameter, {ADVISED:g} are advised: intervals and validation say less than "
            f"they seem to; record for {needed:.2g} s{faster}",
        )


def count_samples(samples: Samples, parameters: int) -> SampleCount:
    """Count by the bandwidth B of the recorded torque: a band of B Hz holds 2 B independent samples a second."""
    seconds = len(samples.torque) * samples.interval
    bandwidth = _bandwidth(samples)
    return SampleCount(
        seconds=seconds,
        bandwidth=bandwidth,
        independent=band_samples(seconds, float(bandwidth.sum())),
        parameters=parameters,
    )


def _bandwidth(samples: Samples) -> np.ndarray:
    """Frequency below which ``POWER`` of the power of each joint's torque lies [Hz], shape (n,)."""
    rate = 1.0 / samples.interval
    grid = np.linspace(0.0, min(samples.band.cutoff, rate / 2), 512)
    power = np.zeros((len(grid), samples.torque.shape[1]))
    for rows in group_slices(samples.group):
        frequency, density = periodogram(samples.torque[rows], rate, "hann", axis=0)
        # groups differ in length: their energies are added on a common grid
        energy = density * (rows.stop - rows.start)
        power += make_interp_spline(frequency, energy, k=1)(grid)
    share_below = np.cumsum(power, axis=0) / np.maximum(power.sum(axis=0), TINY)
    return np.asarray(grid[np.argmax(share_below >= POWER, axis=0)])


# Which recordings are fitted, and which are held out.


HELD_OUT = 1 / 3
"""Share of a single recording that is held out, its end [1]."""


def split(
    case: Case, chosen: Sequence[str] = ()
) -> tuple[list[Recording], list[Recording]]:
    """Recordings to fit, and held-out ones: those chosen by name, else the case's, else the last one or the last third.

    Raises:
        InputError: a name is not that of a recording, or none remains to fit.
    """
    everything = [*case.recordings, *case.judged]
    for name in chosen:
        if name not in [recording.name for recording in everything]:
            raise InputError(
                f"no recording is called {name!r}",
                f"there are {', '.join(r.name for r in everything)}",
                where="--judge",
            )
    if case.judged and not chosen:
        return list(case.recordings), list(case.judged)
    if not chosen and len(everything) == 1:
        (only,) = everything
        cut = int(len(only.t) * (1 - HELD_OUT))
        start = only.part(slice(0, cut), name=f"{only.name}, start")
        end = only.part(slice(cut, None), name=f"{only.name}, end")
        return [start], [end]
    held = list(chosen) or [everything[-1].name]
    fit = [r for r in everything if r.name not in held]
    if not fit:
        raise InputError(
            "every recording is held out, none remains to fit", where="--judge"
        )
    return fit, [r for r in everything if r.name in held]
