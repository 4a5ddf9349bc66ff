"""Checks that separate a recording that cannot be right from one that is merely unusual, and what is put right."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.ndimage import median_filter
from scipy.special import ndtri

from gapscope.arm.display import marked
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.io.layouts import UNITS
from gapscope.arm.io.table import GAP_STEPS, Table, runs
from gapscope.arm.joint_units import joint_unit
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import MOST, STILL, STUCK_TIME, Recording, kept_values

# The clock of a recording: how even its stamps are, and whether its rows were taken evenly though stamped unevenly.
#
# A logger that runs faster than the robot stores a measurement twice now and then, and stamps by its own clock. With
# the repeated rows dropped, their stamps leave a step of two periods in which the robot has moved on by one.


EVEN_RATIO = 0.5
"""Rows are evenly taken if the motion over them is rougher than over the stamps by less than this factor [1]."""
LOST_SAMPLE_STEP = (
    2.5  # A step longer than this many periods has lost samples in it [1]. (hand)
)
CLOCK_WANDER_SAMPLES = (
    25  # Samples over which the slow wander of a clock is taken out. (hand)
)

EVENLY_TAKEN = "rows stamped evenly: by their stamps the motion halts wherever a repeated row was dropped"
"""Note of a recording whose rows were stamped anew."""


def roughness(x: np.ndarray, q: np.ndarray) -> float:
    """Squared distance of samples q [rad], (N, n), from the line through their neighbours over x, (N,), summed [1].

    Relative to each joint's range. Samples that were taken at even times and stamped unevenly leave the line over the
    stamps by speed times the error of the stamp; samples really taken unevenly do so over an even clock.
    """
    before, middle, after = x[:-2], x[1:-1], x[2:]
    share = (middle - before) / (after - before)
    on_line = q[:-2] + share[:, None] * (q[2:] - q[:-2])
    distance = q[1:-1] - on_line
    # a joint that hardly moves would show its quantisation
    travel = np.ptp(q, axis=0)
    moving = travel > 1e-2 * max(float(travel.max()), np.finfo(float).eps)
    return float(((distance[:, moving] / travel[moving]) ** 2).sum())


def even_stamps_of_rows(t: np.ndarray, q: np.ndarray) -> np.ndarray | None:
    """Stamps of rows that were taken evenly [s], (N,): the line through t; ``None`` if the stamps are right.

    Args:
        t: stamps of the rows that are left once repeated ones are dropped [s], (N,).
        q: positions [rad], (N, n).
    """
    steps = np.diff(t)
    # longer steps have lost rows in them: counted, they would be too short
    if len(t) < 2 or steps.max() > LOST_SAMPLE_STEP * np.median(steps):
        return None
    rows = np.arange(len(t), dtype=float)
    return even_stamps(t, rows) if stamps_are_wrong(t, q, rows) else None


def sample_count(t: np.ndarray) -> np.ndarray:
    """Number of each sample on an even clock, from 0, (N,); steps beyond ``LOST_SAMPLE_STEP`` periods skip numbers.

    Shorter steps are taken as one period, or rounded to two if that leaves less unevenness: a jittered step may be
    nearly two periods long, a dropped row leaves a step of two. Of a clock that jitters by half a period even longer
    steps are single ones: all steps are, if that leaves least.
    """
    periods = np.diff(t) / np.median(np.diff(t))
    rounded = np.maximum(np.round(periods), 1.0)
    single = np.where(periods > LOST_SAMPLE_STEP, rounded, 1.0)
    # three ways to count, and the one that leaves the clock most even
    choices = (single, rounded, np.ones_like(periods))
    counts = [np.concatenate([[0.0], np.cumsum(steps)]) for steps in choices]
    return min(counts, key=lambda count: float(np.std(_wander_free(t, count))))


def unevenness(t: np.ndarray) -> np.ndarray:
    """Stamps less an even clock's, without slow wander, in periods, (N,)."""
    return _wander_free(t, sample_count(t))


def even_stamps(t: np.ndarray, count: np.ndarray | None = None) -> np.ndarray:
    """Stamps of an even clock nearest to t [s], (N,): the line through stamps against ``sample_count``, or a count."""
    count = sample_count(t) if count is None else count
    slope, start = np.polyfit(count, t, 1)
    return np.asarray(start + slope * count)


def stamps_are_wrong(
    t: np.ndarray, q: np.ndarray, count: np.ndarray | None = None
) -> bool:
    """Whether the motion is smoother over an even clock than over the stamps, decidedly.

    Each sample is compared with the line through its neighbours. Samples taken at even times and stamped unevenly
    leave the line by speed times the error of the stamp; samples really taken unevenly do so over an even clock.

    Args:
        t: stamps [s], (N,).
        q: positions [rad], (N, n).
        count: number of each sample on the even clock, (N,); ``sample_count`` by default.
    """
    count = sample_count(t) if count is None else count
    return bool(roughness(count, q) < EVEN_RATIO * roughness(t, q))


def _wander_free(t: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Stamps less the line through them and less their moving mean, in periods, (N,)."""
    slope, start = np.polyfit(count, t, 1)
    error = (t - start - slope * count) / slope
    kernel = np.ones(min(CLOCK_WANDER_SAMPLES, len(error)))
    # at the ends fewer samples are in the mean
    inside = np.convolve(np.ones(len(error)), kernel, "same")
    return error - np.convolve(error, kernel, "same") / inside


PLAUSIBLE_RATES = (8.0, 20_000.0)
"""Sampling rates of robot logs [Hz], of loggers of 10 Hz that are late as well; below, no motion is resolved."""

SHORTEST_LOG = 1.0
"""A log that lasts less holds no motion that can be diagnosed [s]: both ends are trimmed by 0.3 s for the gap."""

MAX_SAMPLES = 4_000_000
"""Samples of a motion that is computed as a whole, an hour at 1 kHz: of seven joints they take some GB meanwhile."""

TURN_TOLERANCE = 0.5
"""A step between two samples that differs from a turn by less is a count that starts again [rad]."""

UNSIGNED = "torque is unsigned: only commands and positions can be trusted"
"""Note on a recording whose torque had to be set aside."""

DIAGNOSE_FIRST = "or let gapscope diagnose find out, and go on with the mended_case.yaml that it writes"
"""What to do with a log whose units are unknown."""

REPEATED = "rows dropped that repeat the measurement before them: "
"""Note on rows that a logger stored twice; their number and share follow."""


def check_runs_forward(t: np.ndarray, table: Table, column: str) -> None:
    """Time [s], (N,), has to run forward.

    Raises:
        InputError: t jumps back, leaps, or is constant.
    """
    step = np.diff(t)
    back = np.flatnonzero(step < 0)
    if len(back):
        row = int(back[0]) + 1
        raise InputError(
            f"time jumps back, from {t[row - 1]:.6g} s to {t[row]:.6g} s",
            "split the log there into two recordings, or sort its rows",
            file=table.path,
            where=table.where(row, column),
        )
    if not (step > 0).any():
        raise InputError(
            f"time stands still in all of its rows ({len(t)}), expected a motion",
            "give a longer recording",
            file=table.path,
        )
    usual = float(np.median(step[step > 0]))
    # one stamp far ahead would stretch all that is computed over time
    wide = int(step.argmax())
    if step[wide] > MAX_SAMPLES * usual:
        raise InputError(
            f"time leaps from {t[wide]:.6g} s to {t[wide + 1]:.6g} s, where a step usually takes {usual:.3g} s",
            "correct the stamp, or split the log there into two recordings",
            file=table.path,
            where=table.where(wide + 1, column),
        )


def check_rate(t: np.ndarray, table: Table, column: str, *, any_unit: bool) -> None:
    """Time [s], (N,), has to have a rate at which a robot is logged; in other units too if ``any_unit``.

    Raises:
        InputError: it has an implausible rate.
    """
    step = np.diff(t)
    rate = 1 / float(np.median(step[step > 0]))
    low, high = PLAUSIBLE_RATES
    unit = unit_of_stamps(rate, float(t[-1] - t[0]))
    if not unit:
        remedy = "correct the unit or rate of import: time"
        raise InputError(
            f"the rate is {rate:.3g} Hz, expected {low:g} to {high:g} Hz",
            f"log at a higher rate, or {remedy}" if rate < low else remedy,
            file=table.path,
            where=f"column {column}",
        )
    if unit != "s" and not any_unit:
        raise InputError(
            f"looks like {unit}: taken as s the rate is {rate:.3g} Hz, expected {low:g} to {high:g} Hz",
            f"say in the case: import: {{time: {{column: {column}, unit: {unit}}}}}, or rate: where it counts samples; "
            + DIAGNOSE_FIRST,
            file=table.path,
            where=f"column {column}",
        )


def unit_of_stamps(rate: float, duration: float) -> str:
    """Unit of stamps: s if robots are logged at that rate, else the first in which they are; empty if none is.

    In ms, us or ns the log has to last as well: one at 5 Hz is not over in 60 ms.

    Args:
        rate: of the stamps, taken as s [Hz].
        duration: from the first to the last, taken as s [s].
    """
    low, high = PLAUSIBLE_RATES
    # seconds first, else the finest unit would always do
    for unit in ("s", "ms", "us", "ns"):
        factor = UNITS[unit]
        lasts = unit == "s" or duration * factor >= SHORTEST_LOG
        # stamps of 0.1 s round to a little more
        if 0.99 * low <= rate / factor <= 1.01 * high and lasts:
            return unit
    return ""


def check_positions(
    recording: Recording, arm: NominalArm, table: Table, *, any_unit: bool
) -> tuple[str, ...]:
    """Positions must be radians, or metres of slides, unless ``any_unit``; a note for each beyond the URDF's range.

    Raises:
        InputError: a joint with limits moves far outside them and beyond 7 rad, a slide beyond 0.7 m.
    """
    notes, q = [], recording.q
    joints = (arm.joints, arm.sliding, arm.per_radian)
    limits = RigidBody(arm).position_limits()
    ranges = zip(*joints, *limits, q.min(axis=0), q.max(axis=0), strict=True)
    for j, (joint, slides, size, lower, upper, low, high) in enumerate(ranges, 1):
        said = (
            f"q{j} goes from {low:.4g} to {high:.4g}, "
            f"{joint} is limited to {lower:.4g} to {upper:.4g} {joint_unit('rad', slides)}"
        )
        reach, allowed = max(-low, high), max(abs(lower), abs(upper))
        # beyond a turn and far outside the limits: another unit or side, not a bad limit
        if reach > 7 * size and reach > 1.5 * allowed and not any_unit:
            remedy = "check the unit, the order of the joints and the transmission in the case's import section"
            unit, words = ("mm", "millimetres") if slides else ("deg", "degrees")
            if reach * UNITS[unit] <= 1.2 * allowed:
                said += f": looks like {words}"
                remedy = (
                    f"say in the case: import: {{q: {{column: ..., unit: {unit}}}}}"
                )
            raise InputError(
                said,
                f"{remedy}; {DIAGNOSE_FIRST}",
                file=table.path,
                where=f"column q{j}",
            )
        # an arm with another zero is a little beyond its limits: noted, not refused
        if low < lower - 0.1 * size or high > upper + 0.1 * size:
            notes.append(f"{said}: check unit, offset and order of the joints")
    return tuple(notes)


def noted(recording: Recording, *notes: str, **changed: Any) -> Recording:
    """The recording with further notes, on what of it has changed."""
    return replace(recording, notes=(*recording.notes, *notes), **changed)


def without_turns(recording: Recording) -> Recording:
    """The recording without jumps by a turn, as a robot that counts from 0 to 360 degrees makes.

    Positions of its joints run on, around the turn that is nearest to zero, and references beside them.
    """
    channels, q = recording.channels, recording.q
    positions = {name: channels[name] for name in ("q", "q_ref") if name in channels}
    turned = np.zeros(recording.n_joints, dtype=bool)
    for x in positions.values():
        step = np.abs(np.diff(x, axis=0))
        by_a_turn = np.abs(step - 2 * np.pi) < TURN_TOLERANCE
        # positions in another unit have steps of all sizes
        plain = (by_a_turn | (step < TURN_TOLERANCE)).all(axis=0)
        turned |= by_a_turn.any(axis=0) & plain
    if not turned.any():
        return recording
    # where one joint starts again after a turn, those that did not get there count likewise
    counted = turned | ((q >= 0) & (q <= 2 * np.pi)).all(axis=0)
    for name, x in positions.items():
        steady = np.unwrap(x, axis=0)
        # the turn nearest to zero, by the middle of the whole way; a reference is on that of its joint
        middle = (steady.max(axis=0) + steady.min(axis=0)) / 2
        if name == "q_ref":
            middle = np.median(steady - positions["q"], axis=0)
        steady = steady - 2 * np.pi * np.round(middle / (2 * np.pi))
        positions[name] = np.where(counted, steady, x)
    said = f"jumps by a turn between two samples taken back: {marked(turned, 'q')}"
    return noted(recording, said, **positions)


def repeated_rows(
    t: np.ndarray, values: dict[str, np.ndarray]
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Rows that repeat the time stamp or the whole measurement before them; mask of shape (N,), and notes.

    A logger faster than the robot's bus stores a measurement twice. It is treated as that if every measured
    channel, a noisy one (velocity or torque) among them, repeats for so few rows that no gap is left, and something
    moves on after them; an arm at rest repeats itself for longer and keeps its rows.
    """
    notes = []
    stamp = np.r_[False, np.diff(t) == 0]
    if stamp.any():
        notes.append(
            f"rows dropped that repeat the time stamp before them: {stamp.sum()}"
        )
    stale = np.zeros(len(t), dtype=bool)
    # positions alone repeat themselves as often as the encoder is coarse
    if "dq" in values or "tau" in values:
        same = np.r_[False, np.ones(len(t) - 1, dtype=bool)]
        for name in ("q", "dq", "tau", "tau_sensor"):
            if name in values:
                same[1:] &= (values[name][1:] == values[name][:-1]).all(axis=1)
        for rows in runs(same):
            # not at the end, where nothing moves on after them
            stale[rows] = rows.stop - rows.start < GAP_STEPS and rows.stop < len(t)
    stale &= ~stamp
    if stale.any():
        notes.append(f"{REPEATED}{stale.sum()} ({stale.mean():.2%})")
    return stamp | stale, tuple(notes)


def without_untrusted(recording: Recording) -> Recording:
    """The recording without a torque or torque sensor that cannot be a measurement."""
    for name in ("tau", "tau_sensor"):
        torque = getattr(recording, name)
        if torque is None:
            continue
        # a driver that was asked for no torque writes zeros
        silent = (torque == 0).all(axis=0)
        if silent.all():
            said = f"{name} is zero throughout and was left out"
            recording = noted(recording, said, **{name: None})
        elif silent.any():
            said = f"{marked(silent, name)} zero throughout"
            recording = noted(recording, said)
    if recording.tau is not None and _is_unsigned(recording.q, recording.tau):
        return noted(recording, UNSIGNED, tau=None)
    return recording


def _is_unsigned(q: np.ndarray, tau: np.ndarray) -> bool:
    """Whether tau [N m] never turns negative although at least two joints move to and fro; q [rad], both (N, n).

    Gravity may hold a joint's torque on one side, but then away from zero; an absolute value touches it.
    """
    if (tau < 0).any():
        return False
    step = np.diff(q, axis=0)
    # steps that tell a direction, not the noise of an encoder
    moving = np.abs(step) > 0.05 * np.abs(step).max(axis=0)
    forward = (moving & (step > 0)).sum(axis=0)
    forward_share = forward / np.maximum(moving.sum(axis=0), 1)
    both_ways = (forward_share > 1 - MOST) & (forward_share < MOST)
    to_and_fro = both_ways & (np.ptp(q, axis=0) > 2 * STILL)
    touches_zero = tau.min(axis=0) < 0.05 * tau.max(axis=0)
    return bool(to_and_fro.sum() >= 2 and touches_zero[to_and_fro].all())


# Spikes: one or two samples that leave their neighbours and come back, as bit errors and lost words make them.
#
# A sample is compared with the median of five, itself and two on either side, which neither two spikes beside each
# other nor a step move. Time stamps have no say, so that a jittery clock makes no spikes.


IMPOSSIBLE_ACCELERATION = 1e3
"""Positions that leave their neighbours by more than this asks for are no motion [rad/s^2]; impacts stay below 500."""
SPIKE_DEVIATIONS = 3.0
"""Torques and velocities that leave theirs by so many standard deviations of the joint are none [1]."""
SPIKE_ROUGHNESS = 8.0
"""A spike exceeds the usual second difference by this factor [1]: noise, encoder steps and motion have made that."""
EDGE_ROUGHNESS = 2.0
"""The first and last two positions have neighbours on one side: there this factor is added [1]. Torques are left as
they are there: a controller that is switched on jumps, and what is trimmed from a recording holds it."""
TAIL = 0.025
"""Share of the samples at either end that has no say in deviations, so that spikes do not hide themselves; more spikes
than that are the signal [1]."""

SENSED = ("q", "dq", "tau", "tau_sensor")
BRIDGED = "spikes replaced by the curve through their neighbours: "
"""Note on them; the number of each column follows."""


def without_spikes(recording: Recording, per_radian: np.ndarray) -> Recording:
    """The recording with spikes of what was sensed replaced by the cubic spline through all other samples.

    Args:
        recording: the recording.
        per_radian: what counts as a radian of each joint, (n,): see ``NominalArm.per_radian``.
    """
    t, channels = recording.t, recording.channels
    # in a recording so short a single spike would be more than a tail
    if TAIL * len(t) < 1:
        return recording
    step = float(np.median(np.diff(t)))
    out: dict[str, np.ndarray] = {}
    counts = []
    for name in SENSED:
        if name not in channels:
            continue
        low, high = np.quantile(channels[name], (TAIL, 1 - TAIL), axis=0)
        # the standard deviation by two quantiles, on which spikes have no hold
        deviation = (low - high) / (2 * ndtri(TAIL))
        least = SPIKE_DEVIATIONS * deviation
        if name == "q":
            # one sample that is off by d asks for an acceleration of 2 d / h^2
            least = 0.5 * IMPOSSIBLE_ACCELERATION * step**2 * per_radian
        for j, series in enumerate(channels[name].T):
            rows = spikes(series, float(least[j]), ends=name == "q")
            if len(rows):
                # copied once, when the first spike is found
                if name not in out:
                    out[name] = channels[name].copy()
                out[name][:, j] = _bridged(t, series, rows)
                counts.append(f"{name}{j + 1} {len(rows)}")
    return noted(recording, BRIDGED + ", ".join(counts), **out) if out else recording


def spikes(series: np.ndarray, least: float, *, ends: bool) -> np.ndarray:
    """Places of the spikes of a series, (N,), that are larger than ``least``; none if there are too many.

    ``ends``: whether the first and last two samples may be some.
    """
    bends = np.abs(np.diff(series, n=2))
    # resting rows have none: the usual one is of those that change
    usual = float(np.median(bends[bends > 0])) if bends.any() else 0.0
    threshold = max(least, SPIKE_ROUGHNESS * usual)
    none = np.zeros(0, dtype=int)
    # most series have no spike, and a look at their second differences says so
    if threshold <= 0 or bends.max() < threshold:
        return none
    found = np.abs(series - median_filter(series, 5)) > threshold
    found[:2] = found[-2:] = False
    places = np.arange(len(series))
    cleaned = _bridged(places, series, np.flatnonzero(found))
    for end in (cleaned, cleaned[::-1]) if ends else ():
        # the first two samples on the line through those after them, if they are farther off
        for k in (1, 0):
            expected = 2 * end[k + 1] - end[k + 2]
            if abs(end[k] - expected) > EDGE_ROUGHNESS * threshold:
                end[k] = expected
    # a spike moves the median of its neighbours as well
    found = np.abs(series - cleaned) > threshold
    # farther from those beside it than these from each other; beside a leap, as of an encoder that was stuck, it is not
    good = places[~found]
    after = np.clip(np.searchsorted(good, places), 1, len(good) - 1)
    left, right = series[good[after - 1]], series[good[after]]
    found &= np.abs(series - 0.5 * (left + right)) > np.abs(right - left)
    return np.flatnonzero(found) if found.mean() <= TAIL else none


def _bridged(t: np.ndarray, series: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """A series with some of its rows taken from the cubic spline through all others, (N,)."""
    good = np.ones(len(series), dtype=bool)
    good[rows] = False
    out = series.copy()
    out[rows] = make_interp_spline(t[good], series[good], k=3)(t[rows])
    return out


# Positions that an encoder or driver kept while the arm moved on: they stand still, and then leap.
#
# Where the arm was meanwhile is unknown: the rows are left out, and leave a gap in time.


LEAP = 20.0
"""It was stuck if it then leaps by so many of its usual steps [1]."""
LEFT_OUT = "rows left out in which a position stands still and then leaps: "
"""Note on them; their number and share follow."""


def without_stuck(recording: Recording) -> Recording:
    """The recording without rows in which a position is stuck."""
    t, q = recording.t, recording.q
    stuck = np.zeros(q.shape, dtype=bool)
    for j, series in enumerate(q.T):
        starts, stops = kept_values(series)
        # the leap at the end of each run of one value
        leap = np.abs(np.diff(series[starts], append=series[-1]))
        # the last run ends with the recording, and leaps nowhere
        usual = np.median(leap[:-1]) if len(leap) > 1 else np.inf
        long = t[stops - 1] - t[starts] >= STUCK_TIME
        for place in np.flatnonzero(long & (leap > LEAP * usual)):
            # the first of them was measured
            stuck[starts[place] + 1 : stops[place], j] = True
    rows = np.asarray(stuck.any(axis=1))
    if not rows.any():
        return recording
    joints = marked(stuck.any(axis=0), "q")
    said = f"{LEFT_OUT}{rows.sum()} ({rows.mean():.2%}), {joints}"
    return noted(recording.part(~rows), said)


# All of this, in the order in which a reader does it.


def put_right(
    recording: Recording, per_radian: np.ndarray, *, every_row: bool = False
) -> Recording:
    """The recording without turns, torques that are none, spikes, and rows that are stuck; notes say what was found.

    Args:
        recording: whose time runs on.
        per_radian: what counts as a radian of each joint, (n,).
        every_row: leave spikes and rows that are stuck as they are.
    """
    # turns first: they would look like stuck encoders that leap
    recording = without_untrusted(without_turns(recording))
    # spikes before stuck rows: a spike ends a run of one value
    if not every_row:
        recording = without_stuck(without_spikes(recording, per_radian))
    step = np.diff(recording.t)
    wide = step > LOST_SAMPLE_STEP * np.median(step)
    if wide.any():
        said = f"gaps in time: {wide.sum()}, the longest {step.max():.3g} s"
        recording = noted(recording, said)
    return recording
