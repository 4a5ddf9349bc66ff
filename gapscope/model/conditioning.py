"""Signal conditioning: from a recording to motions and torques that can be compared.

Both sides of the equation of motion pass the same zero-phase filter, so that it removes the same band from both.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.ndimage import maximum_filter1d
from scipy.signal import butter, sosfiltfilt, welch
from scipy.stats import chi2

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.io.plausibility import SHORTEST_LOG
from gapscope.arm.io.table import GAP_STEPS
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.motions.motion import Motion
from gapscope.arm.recording import Recording, held_torque

TORQUE_CUTOFF = 12.0
"""Cut-off of the torque gap [Hz], by definition of ``torque_nrmse``."""
TRIM = 0.3
"""Time cut from both ends of a filtered segment [s], by definition of ``torque_nrmse``."""
MIN_SCALE_SHARE = 0.05
"""A joint's normalisation, over the largest joint's deviation, at least [1]: part of what ``torque_nrmse`` is."""
MIN_FLOOR = 1e-9
"""A healthy arm leaves no less than this [N m]: keeps a joint without any torque from dividing by zero. (physical)"""
WORKING_RATE = 250.0
"""Recordings sampled at twice this rate or faster are decimated to no less than it [Hz]."""
SHORTEST = SHORTEST_LOG
"""Segments shorter than this [s] are left out; what is trimmed leaves 0.4 s."""
ORDER = 4
"""Order of every low-pass. (definition)"""
MIN_CUTOFF, LARGEST_CUTOFF = 5.0, 40.0
"""Limits of the cut-off for positions [Hz]."""
BY_CHANCE = 0.01
"""Probability that noise has as much power at some frequency as what is taken for motion, or for a vibration [1]."""
CUTOFFS = 40
"""Cut-offs between them that are tried. (budget)"""
FEWEST_ROWS = 8
"""Samples of a window of which a spectrum is made, and of a log that is looked at for jumps, at least [1].
(definition)"""
MIN_STEP = 1e-6
"""Stamps closer than this share of a period are one stamp [1]."""

BRIDGED_GAP = 0.04
"""Longest step of time [s] over which a log that is all gaps is interpolated: samples so far apart still show the band
of the torque gap, 12 Hz. A torque that was not measured spoils those so near to it."""


STANDS_OUT = 3.0
"""A reading that jumps departs from its neighbours by so many times as much as anywhere else [1]: of noise and of
smooth motion the largest departure and the next one are about alike. (hand)"""
MAX_JUMPS = 3
"""Jumps of a joint in a recording. (budget)"""


@dataclass(frozen=True)
class Segment:
    """A piece of a recording without gaps, on a uniform grid, N samples of n joints.

    Attributes:
        recording: name of the recording.
        motion: recorded positions after the zero-phase low-pass, with their derivatives.
        torque: recorded torque on the same grid [N m], (N, n); ``None`` if the recording has none.
        torque_sensor: joint torque sensor on the same grid [N m], (N, n), or ``None``.
        payload: known body that was mounted on the last link, or ``None``.
        unknown: samples whose torque was not measured, and what the filters make of them, mask (N, n): limits that were
            reached, stuck sensors; ``None`` if there are none.
        temperature: of the joints on the same grid [deg C], (N, n), or ``None``.
    """

    recording: str
    motion: Motion
    torque: np.ndarray | None
    torque_sensor: np.ndarray | None = None
    payload: KnownLoad | None = None
    unknown: np.ndarray | None = None
    temperature: np.ndarray | None = None

    def bodies(self, nominal: RigidBody) -> RigidBody:
        """Bodies of the nominal arm with the known body that was mounted, the same object if there was none."""
        return nominal.carrying(self.payload)

    def known_torque(self, nominal: RigidBody) -> np.ndarray:
        """Torque that the known body needs on this motion [N m], (N, n); zero if there was none."""
        m = self.motion
        if self.payload is None:
            return np.zeros_like(m.q)
        return np.asarray(
            nominal.link_regressor(nominal.last_link, m.q, m.dq, m.ddq)
            @ self.payload.parameters
        )

    def bridged(self, gap: np.ndarray) -> np.ndarray:
        """A gap between torques, (N, n), by straight lines over what was not measured; else the same array."""
        if self.unknown is None:
            return gap
        out, rows = gap.copy(), np.arange(len(gap))
        for j, missing in enumerate(self.unknown.T):
            # a joint that was never measured has nothing to bridge from
            if missing.any() and not missing.all():
                known = ~missing
                out[missing, j] = np.interp(rows[missing], rows[known], gap[known, j])
        return out

    @property
    def recorded_torque(self) -> np.ndarray:
        """The recorded torque of a segment that has one [N m], (N, n)."""
        assert self.torque is not None
        return self.torque

    @property
    def measured(self) -> np.ndarray:
        """Whether each torque was measured, mask (N, n)."""
        if self.unknown is None:
            return np.ones(self.motion.q.shape, dtype=bool)
        return ~self.unknown

    @property
    def inner(self) -> slice:
        """The samples that are left when both ends are trimmed by ``TRIM``."""
        edge = _edge(self.motion.rate)
        return slice(edge, len(self.motion.t) - edge)


def _edge(rate: float) -> int:
    """Samples that trimming takes from each end."""
    return int(np.ceil(round(TRIM * rate, 1)))


@cache
def _butterworth(cutoff: float, rate: float) -> np.ndarray:
    """Second-order sections of a Butterworth low-pass of order 4; to design it takes as long as to filter 1000 rows."""
    return np.asarray(butter(ORDER, cutoff, output="sos", fs=rate))


def low_pass(series: np.ndarray, rate: float, cutoff: float) -> np.ndarray:
    """Zero-phase Butterworth low-pass (order 4, forward and backward) along axis 0; cut-off at most 0.95 of Nyquist."""
    sos = _butterworth(min(cutoff, 0.95 * rate / 2), rate)
    # the ends are extended by three periods of the cut-off
    three_periods = int(3 * rate / min(cutoff, rate / 2))
    padding = min(len(series) - 1, three_periods)
    return sosfiltfilt(sos, series, axis=0, padlen=padding)


def torque_scale(torque: np.ndarray) -> np.ndarray:
    """Normalisation of the torque gap [N m], shape (n,): standard deviation, at least 5 % of the largest joint's."""
    deviation = torque.std(axis=0)
    return np.maximum(deviation, MIN_SCALE_SHARE * deviation.max())


def position_cutoffs(recording: Recording) -> np.ndarray:
    """Cut-off of each joint's positions [Hz], (n,): that by which their accelerations are least in error.

    Of motion with power density S, recorded with noise of density N, the zero-phase filter H = 1 / (1 + (f / f_c)^8)
    leaves a mean square error of the accelerations of

        E(f_c) = sum_f (2 pi f)^4 ((1 - H)^2 S + H^2 N).

    N is the mean density above a quarter of the rate; S is what is more than that, where noise has as much at no
    frequency with a probability of 99 %. Both are densities of second differences, over their gain: of the
    positions themselves more leaks from slow motion into all frequencies of a window than there is noise. Cut-offs
    lie between 5 and 40 Hz, and below 0.8 of Nyquist. What was not recorded for ``SHORTEST`` seconds or more has no
    spectrum: the parts before and after it are looked at apart.
    """
    rate = recording.rate
    largest = min(LARGEST_CUTOFF, 0.4 * rate)
    tried = np.geomspace(min(MIN_CUTOFF, largest), largest, CUTOFFS)
    error = np.zeros((CUTOFFS, recording.q.shape[1]))
    spans = _pieces(recording.t, SHORTEST, _after_jumps(recording)) or [slice(None)]
    for span in spans:
        q = uniform(recording.t[span], recording.q[span], rate)[1]
        error += len(q) * _acceleration_error(q, rate, tried)
    return np.asarray(tried[error.argmin(axis=0)])


def _acceleration_error(q: np.ndarray, rate: float, tried: np.ndarray) -> np.ndarray:
    """E of cut-offs that are tried, (K,), on positions (N, n): (K, n), but for what is the same for all of them."""
    second = np.diff(q, 2, axis=0)
    # of a time in another unit the rate may be next to nothing
    window = min(len(second), max(int(4 * rate), FEWEST_ROWS))
    frequency, density = welch(second, rate, nperseg=window, axis=0, detrend=False)
    frequency, density = frequency[1:], density[1:]
    # power gain of a second difference: abs(1 - exp(-2 pi i f / rate))^4
    density = density / (2 * np.sin(np.pi * frequency / rate)[:, None]) ** 4
    noise = density[frequency > rate / 4].mean(axis=0)
    # of noise twice the sum over windows, over its density, is distributed as chi-squared
    freedom = 2 * max(1, len(second) // window)
    most = chi2.ppf((1.0 - BY_CHANCE) ** (1.0 / len(frequency)), freedom) / freedom
    signal = np.where(density > most * noise, density - noise, 0.0)
    # beyond twice the largest all pass alike
    band = frequency < 2 * tried[-1]
    weight = (2 * np.pi * frequency[band]) ** 4
    passed = 1 / (1 + (frequency[band] / tried[:, None]) ** (2 * ORDER))
    lost = ((1 - passed) ** 2 * weight) @ signal[band]
    return np.asarray(lost + (passed**2 * weight).sum(axis=1)[:, None] * noise)


def position_cutoff(recordings: Sequence[Recording]) -> float:
    """The largest cut-off of any joint's positions in any recording [Hz]."""
    return float(max(position_cutoffs(one).max() for one in recordings))


def uniform(
    t: np.ndarray, series: np.ndarray, rate: float
) -> tuple[np.ndarray, np.ndarray]:
    """Series on a uniform grid of the given rate [Hz]; the samples themselves if t is uniform to 1 %."""
    intervals = np.diff(t)
    if np.abs(intervals * rate - 1).max(initial=0.0) < 0.01:
        return t, series
    # a step of next to nothing has no slope
    apart = np.append(True, intervals * rate > MIN_STEP)
    t, series = t[apart], series[apart]
    # the small number keeps a last sample that rounding would drop
    last = int((t[-1] - t[0]) * rate + 1e-6)
    grid = t[0] + np.arange(last + 1) / rate
    return grid, make_interp_spline(t, series, k=1)(grid)


def pieces(recording: Recording) -> list[slice]:
    """Slices of a recording between its gaps and jumps, those of at least ``SHORTEST`` seconds.

    A log that loses rows all over has no such piece; then only steps longer than ``BRIDGED_GAP`` count as gaps.
    """
    longest_step = GAP_STEPS / recording.rate
    apart = _after_jumps(recording)
    found = _pieces(recording.t, longest_step, apart)
    if not found and longest_step < BRIDGED_GAP:
        found = _pieces(recording.t, BRIDGED_GAP, apart)
    return found


@dataclass(frozen=True)
class Jump:
    """A reading that jumps.

    Attributes:
        sample: first one after it.
        joint: from 0.
        size: of the step, less what the joint moved [rad or m].
        error: by how much the line through what follows is off that through what came before by another size, or the
            largest departure anywhere else if that is more [rad or m].
    """

    sample: int
    joint: int
    size: float
    error: float


def jumps(recording: Recording) -> list[Jump]:
    """Readings that jump, as that of an encoder that slips does.

    At a jump the difference of two samples departs from the mean of those before and after it much farther than it does
    anywhere else, and by more than the joint moves in a sample anywhere else; and what follows stays off the line of
    what came before. A gap in time is none.
    """
    t, q = recording.t, recording.q
    if len(t) < FEWEST_ROWS:
        return []
    step = np.diff(t)[:, None]
    velocity = np.diff(q, axis=0) / step
    departure = np.zeros_like(velocity)
    # the velocity of a step less the mean of both neighbours, as a distance
    departure[1:-1] = (velocity[1:-1] - (velocity[:-2] + velocity[2:]) / 2) * step[1:-1]
    # nobody saw where a joint went while nothing was logged
    gaps = np.diff(t) > GAP_STEPS / recording.rate
    departure[gaps] = 0.0
    found = []
    for j, series in enumerate(np.abs(departure).T):
        peaks, error = _standing_out(series)
        # how far it moves in a sample, jumps and gaps aside
        moved = np.where(gaps, 0.0, np.abs(np.diff(q[:, j])))
        moved[peaks] = 0.0
        for k in peaks:
            size, line = departure[k, j], _off_line(t, q[:, j], k)
            # a wrong reading comes back to the line of before, a slip stays off it
            stays = abs(line) > abs(q[k + 1, j] - q[k, j]) / 2
            if series[k] > moved.max() and stays:
                # of exact positions both errors are zero: then what numbers resolve
                apart = max(error, abs(line - size), np.spacing(abs(size)))
                found.append(Jump(k + 1, j, float(size), float(apart)))
    return sorted(found, key=lambda jump: jump.sample)


def slips(recording: Recording) -> list[Jump]:
    """Jumps of one reading alone, which no lost rows explain: these move every joint on that is in motion.

    They are clearly larger than their own error: a joint that starts or stops jerks a little.
    """
    found = [x for x in jumps(recording) if abs(x.size) > STANDS_OUT * x.error]
    samples = [jump.sample for jump in found]
    alone = [jump for jump in found if samples.count(jump.sample) == 1]
    if not alone:
        return []
    speed = np.gradient(recording.q, recording.t, axis=0)
    return [jump for jump in alone if not _rows_lost(jump, speed, recording)]


def _rows_lost(jump: Jump, speed: np.ndarray, recording: Recording) -> bool:
    """Whether the other joints may have moved on as far as lost rows would have let this one jump."""
    before = speed[max(0, jump.sample - 6) : jump.sample - 1].mean(axis=0)
    if before[jump.joint] * jump.size <= 0:
        # lost rows let a joint jump on, not back
        return False
    # for how long rows would be lacking [s]
    lost = jump.size / before[jump.joint]
    lines = [_off_line(recording.t, q, jump.sample - 1) for q in recording.q.T]
    # half of it is more than the lines can be wrong by
    stayed = np.abs(lines) < np.abs(before * lost) / 2
    return not stayed.any()


def without_slips(recording: Recording) -> Recording:
    """The recording with its slips taken out of what follows."""
    q = recording.q.copy()
    found = slips(recording)
    for jump in found:
        q[jump.sample :, jump.joint] -= jump.size
    return replace(recording, q=q) if found else recording


def _standing_out(size: np.ndarray) -> tuple[list[int], float]:
    """Places of the few peaks that are ``STANDS_OUT`` times as large as all that is left without them, and that."""
    left, peaks = size.copy(), []
    # one peak more than there may be jumps: it says how far all else departs
    for _ in range(MAX_JUMPS + 1):
        k = int(left.argmax())
        peaks.append((k, float(left[k])))
        # a jump shows in its neighbours as well
        left[max(0, k - 3) : k + 4] = 0.0
    # several alike stand out only together, from the next smaller one
    for count in range(MAX_JUMPS, 0, -1):
        if peaks[count - 1][1] > STANDS_OUT * peaks[count][1]:
            return [k for k, _ in peaks[:count]], peaks[count][1]
    return [], peaks[0][1]


def _after_jumps(recording: Recording) -> list[int]:
    return [jump.sample for jump in jumps(recording)]


def _off_line(t: np.ndarray, q: np.ndarray, k: int) -> float:
    """By how much a series is off the line of what came before from sample k + 1 on: not after a row that is repeated.

    Of the first row after a jump nothing is known: it may lie between.
    """
    before, after = np.arange(max(0, k - 4), k), np.arange(k + 2, min(len(t), k + 6))
    if min(len(before), len(after)) < 2:
        return 0.0
    middle = (t[k] + t[k + 1]) / 2
    # the intercepts: both lines halfway between the two samples
    ends = [np.polyfit(t[some] - middle, q[some], 1)[1] for some in (before, after)]
    return float(ends[1] - ends[0])


def _pieces(t: np.ndarray, longest_step: float, apart: Sequence[int]) -> list[slice]:
    """Slices of stamps t [s] of at least ``SHORTEST`` seconds.

    They end at steps longer than one given [s], and before some samples.
    """
    first_after_gap = np.flatnonzero(np.diff(t) > longest_step) + 1
    edges = [0, *sorted({*first_after_gap.tolist(), *apart}), len(t)]
    spans = [slice(start, stop) for start, stop in itertools.pairwise(edges)]
    # stamps of one second may differ from it by rounding
    shortest = SHORTEST - 1e-6
    return [span for span in spans if t[span.stop - 1] - t[span.start] >= shortest]


def condition(recording: Recording, cutoff: float | None = None) -> list[Segment]:
    """Segments of a recording, positions low-passed and differentiated by a quintic spline.

    Args:
        recording: the recording.
        cutoff: of all positions [Hz]; ``None``: of each joint as its spectrum asks for (``position_cutoffs``).

    Raises:
        InputError: no piece of the recording between two gaps is long enough.
    """
    spans = pieces(recording)
    if not spans:
        whole = recording.t[-1] - recording.t[0]
        problem = f"no stretch without a gap lasts {SHORTEST:g} s"
        if whole < SHORTEST:
            problem = f"lasts {whole:.3g} s, at least {SHORTEST:g} s is needed"
        raise InputError(
            problem,
            "record for longer, or repair the time stamps",
            file=recording.name,
        )
    n = recording.q.shape[1]
    cutoffs = position_cutoffs(recording) if cutoff is None else np.full(n, cutoff)
    return [_segment(recording, span, cutoffs) for span in spans]


def every_so_many(rate: float, least: float) -> int:
    """Every how many samples are kept of a rate [Hz] that is decimated to no less than another."""
    # the small number keeps a step that rounding would drop
    return max(1, int(rate / least + 1e-6))


def thinned(segment: Segment, rate: float) -> Segment:
    """A segment decimated to no less than ``rate`` [Hz], its torques low-passed before."""
    own = segment.motion.rate
    step = every_so_many(own, rate)
    filtered: dict[str, Any] = {
        name: _anti_aliased(getattr(segment, name), own, step)
        for name in ("torque", "torque_sensor", "temperature")
    }
    return _cut(replace(segment, **filtered), slice(None, None, step))


def blocks(segment: Segment, count: int) -> list[Segment]:
    """A segment cut into blocks of equal length, which overlap only by what trimming takes from their ends."""
    count_samples = len(segment.motion.t)
    edge = _edge(segment.motion.rate)
    cuts = np.linspace(edge, count_samples - edge, count + 1).astype(int)
    # each block is longer by what trimming takes, so that the trimmed blocks meet
    spans = [
        slice(start - edge, stop + edge) for start, stop in itertools.pairwise(cuts)
    ]
    return [_cut(segment, span) for span in spans]


def _cut(segment: Segment, rows: slice) -> Segment:
    """Some samples of a segment."""
    series = dict[str, Any]()
    for name in ("torque", "torque_sensor", "unknown", "temperature"):
        own = getattr(segment, name)
        series[name] = None if own is None else own[rows]
    return replace(segment, motion=segment.motion.part(rows), **series)


def _segment(recording: Recording, span: slice, cutoffs: np.ndarray) -> Segment:
    """One piece of a recording without gaps: filtered, decimated and differentiated."""
    rate = recording.rate
    t, q = uniform(recording.t[span], recording.q[span], rate)
    step = every_so_many(rate, WORKING_RATE)
    grid = t[::step]
    # quintic: the second derivative is then a smooth cubic spline
    smooth = np.empty_like(q)
    # joints that share a cut-off pass the filter together
    for cutoff in np.unique(cutoffs):
        mine = cutoffs == cutoff
        smooth[:, mine] = low_pass(q[:, mine], rate, float(cutoff))
    spline = make_interp_spline(grid, smooth[::step], k=5)
    motion = Motion(grid, spline(grid), spline(grid, 1), spline(grid, 2))

    def on_grid(series: np.ndarray | None) -> np.ndarray | None:
        if series is None:
            return None
        regular = uniform(recording.t[span], series[span], rate)[1]
        filtered = _anti_aliased(regular, rate, step)
        return None if filtered is None else filtered[::step]

    return Segment(
        recording=recording.name,
        motion=motion,
        torque=on_grid(recording.tau),
        torque_sensor=on_grid(recording.tau_sensor),
        payload=recording.payload,
        unknown=_unknown_torque(recording, span, grid),
        temperature=on_grid(recording.temperature),
    )


def _anti_aliased(
    series: np.ndarray | None, rate: float, step: int
) -> np.ndarray | None:
    """Series at ``rate`` [Hz], low-passed at 0.8 of the Nyquist frequency of every ``step``-th sample."""
    if series is None or step == 1:
        return series
    return low_pass(series, rate, 0.4 * rate / step)


def _unknown_torque(
    recording: Recording, span: slice, grid: np.ndarray
) -> np.ndarray | None:
    """Which torques of a piece were not measured, or are mixed with such by filters; ``None`` if all were.

    Args:
        recording: the recording.
        span: rows of the piece.
        grid: times at which it is asked [s], (M,).

    Returns:
        A mask (M, n).
    """
    if recording.tau is None:
        return None
    t = recording.t[span]
    held = held_torque(t, recording.q[span], recording.tau[span]).unknown
    if not held.any():
        return None
    near = int(np.ceil(BRIDGED_GAP * recording.rate))
    # a maximum over a window widens the mask to both sides
    widened = maximum_filter1d(held.astype(np.uint8), 2 * near + 1, axis=0)
    places = np.clip(np.searchsorted(t, grid), 0, len(t) - 1)
    return np.asarray(widened[places] > 0)
