"""Recordings, and what the torque column of one may be: steps, held values, set points, split logs."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline

from gapscope.arm.errors import InputError
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.motions.motion import whole_rate

# A recording: time series of one motion of one arm.


CHANNELS = ("q", "dq", "tau", "q_ref", "dq_ref", "tau_sensor", "temperature")
"""Names of the per-joint channels, in the order in which files hold them."""
USUAL_STEP = 0.01
"""Largest difference of a usual step of time from the median step, over it [1]: the resolution of a clock of dates in
double precision is 0.1 % of the step of a log at 5 kHz."""

SLOW_RATE = 100.0
"""Below, delays, elasticity and ripple are hardly seen [Hz]. (physical)"""


@dataclass(frozen=True)
class Recording:
    """Time series of one motion, N samples of an arm with n joints; arrays are read-only.

    Attributes:
        name: file name or label of the recording.
        t: time [s], shape (N,), strictly increasing within a segment; gaps are allowed. Readers count it from the
            first row of the log.
        q: joint positions as the encoders gave them [rad], shape (N, n).
        tau: torque commanded or derived from motor current, joint side [N m], (N, n); ``None`` if no torque
            can be trusted.
        dq: recorded velocity [rad/s], (N, n), or ``None``.
        q_ref, dq_ref: reference position [rad] and velocity [rad/s], (N, n), or ``None``.
        tau_sensor: joint torque sensor [N m], (N, n), or ``None``.
        temperature: joint temperature [deg C], (N, n), or ``None``.
        notes: what was noticed or repaired while reading, for the report.
        payload: known body that was mounted on the last link, or ``None``.
        begun: what the log's own clock showed at t = 0 [s]: time since it was switched on, or a date.

    Raises:
        InputError: a channel's shape does not fit ``t`` and ``q``, or a value is not finite.
    """

    name: str
    t: np.ndarray
    q: np.ndarray
    tau: np.ndarray | None = None
    dq: np.ndarray | None = None
    q_ref: np.ndarray | None = None
    dq_ref: np.ndarray | None = None
    tau_sensor: np.ndarray | None = None
    temperature: np.ndarray | None = None
    notes: tuple[str, ...] = ()
    payload: KnownLoad | None = None
    begun: float = 0.0

    def __post_init__(self) -> None:
        """Freeze the arrays and check their shapes."""
        for name in ("t", *CHANNELS):
            value = getattr(self, name)
            if value is not None:
                # frozen: attributes are set behind the dataclass
                object.__setattr__(self, name, _frozen(value))
        if self.t.ndim != 1 or self.q.ndim != 2:
            raise InputError(
                "t must have shape (N,) and q shape (N, n)", file=self.name
            )
        for name, series in self.channels.items():
            if series.shape != self.q.shape:
                raise InputError(
                    f"has shape {series.shape}, expected {self.q.shape} as q has",
                    file=self.name,
                    where=f"channel {name}",
                )
        if len(self.t) != len(self.q):
            raise InputError(
                f"t has {len(self.t)} rows, q has {len(self.q)}", file=self.name
            )
        for name, series in {"t": self.t, **self.channels}.items():
            if not np.isfinite(series).all():
                row, *column = np.argwhere(~np.isfinite(series))[0]
                label = name if not column else f"{name}{column[0] + 1}"
                raise InputError(
                    "is not a finite number",
                    "drop or repair the row; a gap in time is cut, a missing value is never guessed",
                    file=self.name,
                    where=f"row {row + 1}, column {label}",
                )

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return self.q.shape[1]

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]: the inverse of the mean of all steps of t that are usual; nan of a single sample.

        Usual are those that differ from the median by no more than ``USUAL_STEP``; of steps of two kinds, as many of
        each, none does, and the median counts.
        """
        if len(self.t) < 2:
            return float("nan")
        # one lost row makes a step of two: the mean is of those that are usual
        steps = np.diff(self.t)
        median = np.median(steps)
        usual = steps[np.abs(steps - median) <= USUAL_STEP * np.abs(median)]
        step = usual.mean() if len(usual) else median
        return whole_rate(float(1.0 / step))

    @property
    def stamps(self) -> np.ndarray:
        """Time by the log's own clock, to 1e-9 s, shape (N,)."""
        # to the digits that a stamp has; adding a date leaves others
        return np.round(self.t + self.begun, 9) if self.begun else self.t

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.t[-1] - self.t[0])

    @property
    def channels(self) -> dict[str, np.ndarray]:
        """The channels that it has, by name, (N, n) each."""
        channels = {name: getattr(self, name) for name in CHANNELS}
        return {name: series for name, series in channels.items() if series is not None}

    def part(self, rows: np.ndarray | slice, **changed: Any) -> Recording:
        """The recording with some of its rows, a mask, places or a slice; ``changed`` are other attributes."""
        series = {"t": self.t, **self.channels}
        chosen: dict[str, Any] = {name: x[rows] for name, x in series.items()}
        # nobody else has them: shared, not copied
        for x in chosen.values():
            x.setflags(write=False)
        return replace(self, **chosen, **changed)


STILL = 0.01
"""A joint that moves by less rests [rad, or what counts as that of a slide]. (physical)"""


def resting(recordings: Iterable[Recording], per_radian: np.ndarray) -> np.ndarray:
    """Which joints rest in every recording, mask (n,); between recordings an arm may have been moved.

    Args:
        recordings: one at least.
        per_radian: what counts as a radian of each joint, (n,): see ``NominalArm.per_radian``.
    """
    travel = np.max([np.ptp(r.q, axis=0) for r in recordings], axis=0)
    return np.asarray(travel < STILL * per_radian)


def _frozen(value: Any) -> np.ndarray:
    """A read-only array of numbers: the array itself if it is one, as those of another recording are, else a copy."""
    shared = isinstance(value, np.ndarray) and value.dtype == float
    # of another recording, and frozen already: shared
    if shared and not value.flags.writeable:
        return value
    array = np.array(value, dtype=float)
    array.setflags(write=False)
    return array


# Steps in which a torque is recorded: a converter of few bits, or a driver that stores whole units.


MOST = 0.9
"""Share of the samples, or of what lies between them, that is most of them [1]."""
WHOLE = (1 - MOST) / 2
"""A change is a whole number of steps if it differs from one by less [1]: by chance so few do that most do not."""
NOTED = 0.01
"""Steps are noted whose rounding, step / sqrt 12, exceeds this share of the torque's deviation [1]."""


def torque_step(tau: np.ndarray) -> np.ndarray:
    """Step of each joint's torque [N m], (n,), of a torque tau (N, n); 0 if it has none."""
    return np.array([_step(series) for series in tau.T])


def step_notes(recording: Recording) -> tuple[str, ...]:
    """A note on the joints whose torque comes in coarse steps."""
    if recording.tau is None:
        return ()
    steps, deviation = torque_step(recording.tau), recording.tau.std(axis=0)
    # rounding adds noise of step / sqrt 12
    coarse = np.flatnonzero(steps > NOTED * np.sqrt(12.0) * deviation)
    if not len(coarse):
        return ()
    columns = ", ".join(f"tau{j + 1} {steps[j]:.3g}" for j in coarse)
    return (f"torque recorded in coarse steps, which raise the noise floor: {columns}",)


def _step(series: np.ndarray) -> float:
    changes = np.abs(np.diff(series))
    changes = changes[changes > 0]
    if len(changes) < 2:
        return 0.0
    ratio = changes / np.quantile(changes, 1 - MOST)
    whole = np.abs(ratio - np.round(ratio)) < WHOLE
    if whole.mean() < MOST:
        return 0.0
    # over many steps the rounding of the log averages out
    return float(changes[whole].sum() / np.round(ratio[whole]).sum())


# Torques that were not measured though the log holds a number: a sensor's or converter's limit, or a stuck sensor.
#
# A torque that keeps one value, while its joint moves, for far longer than its values usually last. At its largest or
# least value that is a limit that was reached: the joint's torque was larger, by how much is unknown. At any other
# value, and for longer, the sensor or its driver was stuck.


STUCK_TIME = 0.2
"""Any value, of a position too, that is kept for less is left as it is [s]: slow updates and coarse steps do that."""
CLIPPED_RATIO = 5.0
"""A limit was reached if the longest time at the largest or least value is so many times as long as usual [1]."""
STUCK_RATIO = 10.0
"""A sensor was stuck if a value lasts so many times as long as usual [1]."""
HELD_MOTION = 1e-3
"""Share of its travel by which the joint moves meanwhile at least [1]: at rest a command may stand."""
CLIPPED = "rows not used whose torque stands at a limit of the sensor or the drive, its largest or least value"
STUCK = "rows not used whose torque stands while the joint moves, as of a stuck sensor"
"""Notes on them; the share of each column follows."""


class HeldTorque(NamedTuple):
    """Samples of a torque that were not measured, masks (N, n).

    Attributes:
        clipped: at the largest or least value.
        stuck: at any other.
    """

    clipped: np.ndarray
    stuck: np.ndarray

    @property
    def unknown(self) -> np.ndarray:
        """Both, (N, n)."""
        return self.clipped | self.stuck


def held_torque(t: np.ndarray, q: np.ndarray, tau: np.ndarray) -> HeldTorque:
    """Which samples of a torque were not measured.

    Args:
        t: time [s], (N,).
        q: positions, any unit, (N, n).
        tau: torque, any unit, (N, n).
    """
    masks = [_held(t, *joint) for joint in zip(q.T, tau.T, strict=True)]
    return HeldTorque(*np.stack(masks, axis=-1))


def held_notes(recording: Recording) -> tuple[str, ...]:
    """Notes on the joints whose torque was not measured at all times."""
    if recording.tau is None:
        return ()
    held = held_torque(recording.t, recording.q, recording.tau)
    notes = []
    for mask, what in ((held.clipped, CLIPPED), (held.stuck, STUCK)):
        shares = mask.mean(axis=0)
        columns = [f"tau{j + 1} {shares[j]:.1%}" for j in np.flatnonzero(shares)]
        if columns:
            notes.append(f"{what}: {', '.join(columns)}")
    return tuple(notes)


def _held(t: np.ndarray, q: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Samples of one joint's torque, (N,), that were not measured: clipped, and stuck, (2, N)."""
    clipped, stuck = held = np.zeros((2, len(series)), dtype=bool)
    starts, stops = kept_values(series)
    lengths = stops - starts
    # most torques keep no value for long, however short it usually lasts; one that has two values is a switch
    if lengths.max(initial=0) <= CLIPPED_RATIO or len(lengths) <= 2:
        return held
    # a limit keeps its values: they say nothing of how long one usually lasts
    extreme = np.isin(series[starts], (series.min(), series.max()))
    long = t[stops - 1] - t[starts] >= STUCK_TIME
    usual = _usual(lengths[~extreme & ~long])
    least = HELD_MOTION * np.ptp(q)

    def moves(place: int) -> bool:
        return bool(np.ptp(q[starts[place] : stops[place]]) > least)

    for value in (series.min(), series.max()):
        at_limit = np.flatnonzero(series[starts] == value)
        longest = int(at_limit[lengths[at_limit].argmax()])
        if lengths[longest] > CLIPPED_RATIO * usual and moves(longest):
            # the limit counts throughout, even where it was touched for a row
            clipped |= series == value
    for place in np.flatnonzero(long & ~extreme & (lengths > STUCK_RATIO * usual)):
        if moves(place):
            # the first of them was measured
            stuck[starts[place] + 1 : stops[place]] = True
    return held


def kept_values(series: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First row of each value that a series, (N,), keeps, and the row after its last."""
    edges = np.flatnonzero(np.diff(series)) + 1
    return np.r_[0, edges], np.r_[edges, len(series)]


def _usual(lengths: np.ndarray) -> float:
    """Time for which values usually last [rows]: below it they last in most rows; one row if there are none."""
    # by rows, not by values: many short ones count little beside a long one
    ordered = np.sort(lengths)
    rows = np.cumsum(ordered)
    if not len(rows):
        return 1.0
    return float(ordered[np.searchsorted(rows, MOST * rows[-1])])


def slow_words(recording: Recording) -> tuple[str, str]:
    """What the rate of a recording hides, and what to do; empty at a usual rate."""
    # as it is shown: 99.9999 Hz is 100 Hz
    rate = f"{recording.rate:.4g}"
    if not float(rate) < SLOW_RATE:
        return "", ""
    said = f"delays, elasticity and ripple are hardly seen at {rate} Hz"
    return said, f"log at {SLOW_RATE:g} Hz or more"


# Set points of a reference that was recorded at a lower rate than the rest, and the smooth motion through them.


SET_POINT_LEAST = (
    30  # Set points of a reference at least, for their distance to be regular. (hand)
)
# A row is the corner of a line if the second difference there exceeds this share of that at the plainest [1]. (hand)
CORNER_SHARE = 0.02


@dataclass(frozen=True)
class SetPoints:
    """Set points of a recording.

    Attributes:
        variant: ``held`` until the next one, or ``interpolated`` between two by a straight line.
        rows: at which they are.
        every: rows from one to the next, median.
    """

    variant: str
    rows: np.ndarray
    every: int

    def smooth(self, recording: Recording) -> Recording:
        """The recording with the cubic spline through the set points as its reference."""
        assert recording.q_ref is not None
        # a spline without points in a rest would swing there
        rows = _with_rests(self.rows, self.every, len(recording.t))
        t = recording.t
        spline = make_interp_spline(t[rows], recording.q_ref[rows], k=3)
        rate = None if recording.dq_ref is None else spline(t, 1)
        return replace(recording, q_ref=spline(t), dq_ref=rate)


def set_points(recording: Recording) -> SetPoints | None:
    """Set points of a recording's reference; ``None`` if it changes from row to row, or at no regular steps."""
    if recording.q_ref is None or len(recording.t) < SET_POINT_LEAST:
        return None
    step = np.diff(recording.q_ref, axis=0)
    # all joints of a controller have their set points in the same rows
    changed = np.flatnonzero(step.any(axis=1)) + 1
    every = _every(changed)
    if every is not None and not _quantised(step):
        return SetPoints("held", changed, every)
    # a straight line has no second difference but for rounding, its corners have
    travel = np.maximum(np.ptp(recording.q_ref, axis=0), np.finfo(float).eps)
    most = (np.abs(np.diff(step, axis=0)) / travel).max(axis=1)
    # so many corners there have to be: the smallest of them
    plain = np.sort(most)[-SET_POINT_LEAST]
    corners = np.flatnonzero(most > CORNER_SHARE * plain) + 1
    every = _every(corners)
    return None if every is None else SetPoints("interpolated", corners, every)


def _every(rows: np.ndarray) -> int | None:
    """Median distance of rows if it is two or more, and most distances are it or one less or more; rests aside."""
    distance = np.diff(rows)
    if len(distance) < SET_POINT_LEAST:
        return None
    every = int(np.median(distance))
    # longer distances are rests, in which nothing changes
    moving = distance[distance < 4 * every]
    # of two rows, one more or less would be anything
    regular = (np.abs(moving - every) <= 1) & (moving > 1)
    return every if every >= 2 and regular.mean() >= MOST else None


def _quantised(step: np.ndarray) -> bool:
    """Whether all joints step by whole multiples of few sizes: an encoder's or a log's resolution, not a rate."""
    for column in step.T:
        sizes = np.abs(column[column != 0])
        relative = np.round(sizes / sizes.max(initial=np.finfo(float).eps), 4)
        if len(np.unique(relative)) > 10:
            return False
    return True


def _with_rests(rows: np.ndarray, every: int, count: int) -> np.ndarray:
    """Set points, with further ones at the same distance where the reference rests, and the first and last row."""
    edges = np.unique(np.concatenate([[0], rows, [count - 1]]))
    filled = [
        np.arange(first, last, every) if last - first > 2 * every else [first]
        for first, last in itertools.pairwise(edges)
    ]
    return np.concatenate([*filled, edges[-1:]])
