"""Clocks and steps of the log: time stamps, the clock of the torque, quantisation."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.layouts import UNITS
from gapscope.arm.io.plausibility import (
    LEFT_OUT,
    REPEATED,
    repeated_rows,
    stamps_are_wrong,
    unevenness,
    unit_of_stamps,
)
from gapscope.arm.io.table import DAMAGED, GAP_STEPS, PAUSE
from gapscope.arm.nominal import smooth_sign
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import SMALLEST
from gapscope.diagnosis.setup_faults.found_fault import FoundFault, by_recordings
from gapscope.diagnosis.thresholds import (
    AGREED_RATE_ERROR,
    CLOCK_GAIN,
    CLOCK_HINT,
    CLOCK_MIN_SKEW,
    CLOCK_ROUNDS,
    LATTICE_AGREEMENT,
    LATTICE_COHERENCE,
    LATTICE_LEVELS,
    LATTICE_SAMPLES,
    LOG_DIGITS,
    MIN_MOTION,
    NAMED_JITTER,
    NAMED_LOST,
    NAMED_RATE_ERROR,
    NAMED_REPEATS,
    OBVIOUS_FAULT_PROBABILITY,
    RATE_AGREEMENT,
    RATE_BAND,
    RATE_REPEATED,
    STEP_OVER_DATA_SHEET,
    STEP_WITHOUT_DATA_SHEET,
)
from gapscope.effects.catalogue import of_quantity
from gapscope.effects.setup_faults import Fault, TimeStamps, UnitMismatch
from gapscope.model.conditioning import (
    SHORTEST,
    TORQUE_CUTOFF,
    Segment,
    condition,
    low_pass,
)
from gapscope.model.effective_samples import motion_samples
from gapscope.model.readings import (
    FAULT_SAMPLES,
    MOTION_INDEPENDENT_RATE,
)

# Time stamps that are not those of the samples, seen in the recording itself.
#
# Named is what no usual clock does. A logger that runs freely against a robot's bus stores up to some per cent of its
# rows twice; real-time clocks jitter by less than 5 % of their period; quartz clocks keep their rate to 1e-4, so that a
# rate off by 3 %, or by the same 0.7 % in all recordings, is a mistake in the set-up.


VELOCITY_UNITS = {
    1 / UNITS["deg/s"]: "positions in rad with velocities in deg/s",
    UNITS["deg"]: "positions in deg with velocities in rad/s",
    1 / UNITS["rpm"]: "positions in rad with velocities in rpm",
}
"""Velocities over what positions change by per second, of units that do not fit together [1]."""


def find_stamps(
    recordings: Iterable[Recording], *, by_velocity: bool = True
) -> tuple[FoundFault, ...]:
    """Time stamps that are wrong, one finding for each kind, of the recordings that have it.

    Args:
        recordings: as they were read.
        by_velocity: whether recorded velocities tell wrong rates.
    """
    recordings = tuple(recordings)
    found: list[FoundFault] = []
    searches: list[Callable[[tuple[Recording, ...]], FoundFault | None]] = [
        _milliseconds,
        partial(_above, "repeats", repeats, NAMED_REPEATS),
        partial(_above, "jitter", jitter, NAMED_JITTER),
        partial(_above, "gaps", lost, NAMED_LOST),
    ]
    if by_velocity:
        searches.append(_wrong_rate)
    for search in searches:
        fault = search(recordings)
        if fault is not None:
            # the next search sees recordings on which this fault is corrected
            recordings = tuple(fault.repair(r) for r in recordings)
            found.append(fault)
    return tuple(found)


def _milliseconds(recordings: tuple[Recording, ...]) -> FoundFault | None:
    """Stamps that give a rate at which no robot is logged in s, but do in ms."""
    units = {r.name: unit_of_stamps(r.rate, r.duration) for r in recordings}
    names = tuple(name for name, unit in units.items() if unit == "ms")
    if not names:
        return None
    fault = UnitMismatch("milliseconds")
    return FoundFault(fault, OBVIOUS_FAULT_PROBABILITY, recordings=names)


def _above(
    kind: str,
    amount: Callable[[Recording], float],
    most: float,
    recordings: tuple[Recording, ...],
) -> FoundFault | None:
    """The finding on the recordings that have more than this amount; ``None`` if there are none."""
    amounts = {r.name: amount(r) for r in recordings}
    above = {name: share for name, share in amounts.items() if share > most}
    return _stamps(kind, above, recordings)


def _stamps(
    kind: str, amounts: dict[str, float], recordings: Iterable[Recording]
) -> FoundFault | None:
    """The finding on the recordings with these amounts; ``None`` if there are none."""
    if not amounts:
        return None
    return by_recordings(partial(TimeStamps, kind), "amount", amounts, recordings)


def _wrong_rate(recordings: tuple[Recording, ...]) -> FoundFault | None:
    every = {r.name: rate_error(r) for r in recordings}
    _check_units(every)
    errors = {name: error for name, error in every.items() if error is not None}
    logs = np.log(list(errors.values()))
    # a clock is off by the same in all recordings, which a velocity's own filter is not
    agree = len(logs) > 1 and np.ptp(logs) < RATE_REPEATED
    least = AGREED_RATE_ERROR if agree else NAMED_RATE_ERROR
    wrong = {
        name: error for name, error in errors.items() if abs(np.log(error)) > least
    }
    return _stamps("wrong_rate", wrong, recordings)


def _check_units(errors: Mapping[str, float | None]) -> None:
    """Check that no rate seems wrong by what two units of velocity differ by: then the stamps are right.

    Raises:
        InputError: positions and velocities of a recording are in units that do not fit together.
    """
    for name, error in errors.items():
        for factor, units in VELOCITY_UNITS.items():
            if error is not None and abs(np.log(error / factor)) < NAMED_RATE_ERROR:
                raise InputError(
                    f"velocities are {error:.3g} times what the positions change by: {units}",
                    "give the units: import: {q: {column: ..., unit: ...}, dq: {column: ..., unit: ...}}; "
                    "or leave the velocities out: import: {dq: null}",
                    file=name,
                    where="columns q1.., dq1..",
                )


def repeats(recording: Recording) -> float:
    """Share of rows that repeat the measurement before them [1], those that the reader has dropped among them."""
    dropped = _counted(recording, REPEATED)
    if dropped:
        return dropped / (len(recording.t) + dropped)
    repeated, _ = repeated_rows(recording.t, recording.channels)
    return float(repeated.mean())


def _counted(recording: Recording, note: str) -> int:
    """Number of rows that a note of the reader, which begins like this, counts; 0 without it."""
    found = (re.match(re.escape(note) + r"(\d+)", own) for own in recording.notes)
    return next((int(match[1]) for match in found if match), 0)


def jitter(recording: Recording) -> float:
    """Unevenness of stamps over the period, standard deviation [1]; 0 if the samples are as uneven as they say."""
    amount = float(unevenness(recording.t).std())
    if amount > NAMED_JITTER and stamps_are_wrong(recording.t, recording.q):
        return amount
    return 0.0


def lost(recording: Recording) -> float:
    """Share of samples missing in gaps of more than ``GAP_STEPS`` periods [1], rows left out on reading apart.

    Stamps that are as far apart as the shortest piece that is used by itself are a pause: the logger was stopped.
    """
    steps = np.diff(recording.t)
    gaps = (steps * recording.rate > GAP_STEPS) & (steps < SHORTEST)
    missing = float((steps[gaps] * recording.rate - 1).sum())
    left_out = sum(_counted(recording, note) for note in (LEFT_OUT, PAUSE, DAMAGED))
    missing = max(missing - left_out, 0.0)
    return missing / (len(recording.t) + missing)


def rate_error(recording: Recording) -> float | None:
    """Assumed over true period [1]: recorded velocities over those of the positions by the stamps.

    ``None`` if no velocity is recorded, or joints contradict each other. References serve if they have both.
    """
    motions = (
        (recording.q, recording.dq),
        (recording.q_ref, recording.dq_ref),
    )
    for q, dq in motions:
        if q is not None and dq is not None:
            error = _velocity_ratio(recording, q, dq)
            if error is not None:
                return error
    return None


def _velocity_ratio(
    recording: Recording, q: np.ndarray, dq: np.ndarray
) -> float | None:
    """Recorded velocities over those of the positions below ``RATE_BAND``; ``None`` if the joints disagree."""
    rate = recording.rate
    cutoff = min(RATE_BAND, rate / 5)
    beside_gap = np.diff(recording.t) >= 1.5 / rate
    # derivatives across a gap are wrong
    usual = np.zeros(len(q), dtype=bool)
    usual[1:-1] = ~(beside_gap[1:] | beside_gap[:-1])
    # positions two rows apart give the mean velocity between them, which Simpson's rule takes of the recorded one
    derivative, mean = np.gradient(q, recording.t, axis=0), dq.copy()
    mean[1:-1] = (dq[:-2] + 4 * dq[1:-1] + dq[2:]) / 6
    by_stamps, recorded = (low_pass(x, rate, cutoff)[usual] for x in (derivative, mean))
    by_stamps_power = (by_stamps**2).sum(axis=0)
    recorded_power = (recorded**2).sum(axis=0)
    power = by_stamps_power * recorded_power
    product = (by_stamps * recorded).sum(axis=0)
    agree = (power > 0) & (product > RATE_AGREEMENT * np.sqrt(power))
    # A joint that follows friction or noise alone does not agree; half of the joints have to.
    if agree.sum() < max(1, recording.n_joints // 2):
        return None
    ratios = np.sqrt(recorded_power[agree] / by_stamps_power[agree])
    if np.ptp(ratios) > NAMED_RATE_ERROR * np.median(ratios):
        return None
    return float(np.median(ratios))


# A torque whose clock runs at another rate than the motion's: late by more and more, or early.
#
# Two loggers, or two nodes of a bus, whose clocks differ by a share s: the torque that belongs to the motion at t was
# recorded at t + d + s (t - t_0). Both are found by Gauss-Newton steps, the torque of each joint explained by that of
# the nominal bodies and of friction, each with a free factor,
#
#     tau(t + d + s (t - t_0)) = X b,  X = [gravity, the rest of the bodies' torque, a, sgn v, v, 1],
#
# with s the same for all recordings and joints, and d its own for each recording.


TORQUE_CLOCK = "torque_clock"
"""The variant of ``time_stamps``."""


class _Part(NamedTuple):
    """Samples of one recording's segment.

    Attributes:
        t: since the recording began [s], (M,).
        columns: X, (M, n, 6).
        grid, torque, rate: times [s], (N,), at which the torque [N m] and its rate [N m/s] are known, (N, n).
        recording: its number.
    """

    t: np.ndarray
    columns: np.ndarray
    grid: np.ndarray
    torque: np.ndarray
    rate: np.ndarray
    recording: int


class _Step(NamedTuple):
    """A Gauss-Newton step from a clock x = [d of each recording, s], (R + 1,).

    Attributes:
        left: logarithm of what X leaves of the torque's variance there, mean over joints [1].
        fall: share of that which the step promises to take away [1].
        to: where it leads, (R + 1,).
        at: where it begins, (R + 1,).
        spread: variance of s, over what is left of the torque and for one sample.
    """

    left: float
    fall: float
    to: np.ndarray
    at: np.ndarray
    spread: float


def find_torque_clock(case: Case) -> FoundFault | None:
    """The torque's clock as a fault of the time stamps, ``amount`` 1 + s; ``None`` if it keeps up."""
    recordings = tuple(r for r in case.recordings if r.tau is not None)
    body = RigidBody(case.arm)
    try:
        pieces = [(k, s) for k, r in enumerate(recordings) for s in condition(r)]
    except (GapscopeError, ValueError):
        # too short or too odd to be conditioned; what needs the signals says so
        return None
    if not pieces:
        return None
    rows = sum(len(segment.motion.t[segment.inner]) for _, segment in pieces)
    step = max(1, rows // FAULT_SAMPLES)
    parts = [_part(body, s, k, float(recordings[k].t[0]), step) for k, s in pieces]
    even = np.zeros(len(recordings) + 1)
    first = _step(parts, even)
    if first.fall - _step(parts, even, drifts=False).fall < CLOCK_HINT:
        return None
    drift = even.copy()
    drift[-1] = first.to[-1]
    starts = [_best(parts, k * drift) for k in (1, 2, 4)]
    best = min(starts, key=lambda step: step.left)
    share, longest = float(best.at[-1]), max(float(part.t[-1]) for part in parts)
    delayed = _best(parts, even, drifts=False)
    too_little = best.left > delayed.left - CLOCK_GAIN
    if too_little or not CLOCK_MIN_SKEW / longest <= abs(share) <= NAMED_RATE_ERROR:
        return None
    seconds = sum(recording.duration for recording in recordings)
    std = np.sqrt(best.spread * rows / motion_samples(seconds, MOTION_INDEPENDENT_RATE))
    every = (*case.recordings, *case.judged)
    return FoundFault(
        TimeStamps(TORQUE_CLOCK, 1.0 + share),
        OBVIOUS_FAULT_PROBABILITY,
        {"amount": (float(std),)},
        tuple(r.name for r in every if r.tau is not None),
    )


def _part(
    body: RigidBody, segment: Segment, recording: int, start: float, step: int
) -> _Part:
    m, inner = segment.motion, segment.inner
    assert segment.torque is not None
    torque = low_pass(segment.torque, m.rate, TORQUE_CUTOFF)
    q, dq, ddq = (x[inner][::step] for x in (m.q, m.dq, m.ddq))
    bodies, still = segment.bodies(body), np.zeros_like(q)
    gravity = bodies.inverse_dynamics(q, still, still)
    rest = bodies.inverse_dynamics(q, dq, ddq) - gravity
    dry = smooth_sign(dq)
    columns = np.stack([gravity, rest, ddq, dry, dq, np.ones_like(q)], axis=2)
    rate = np.gradient(torque, m.t, axis=0)
    t = m.t - start
    return _Part(t[inner][::step], columns, t, torque, rate, recording)


def _best(parts: list[_Part], start: np.ndarray, drifts: bool = True) -> _Step:
    """The best of some steps, one after the other."""
    steps = [_step(parts, start, drifts)]
    for _ in range(CLOCK_ROUNDS):
        steps.append(_step(parts, steps[-1].to, drifts))
    return min(steps, key=lambda step: step.left)


def _step(parts: list[_Part], x: np.ndarray, drifts: bool = True) -> _Step:
    """A Gauss-Newton step; joints count by how well X explains them. ``drifts``: whether s is free."""
    joints, free = parts[0].torque.shape[1], np.ones(len(x))
    free[-1] = drifts
    normal, right, left = np.zeros((len(x), len(x))), np.zeros(len(x)), 0.0
    for j in range(joints):
        torques, owns, shifts = [], [], []
        for part in parts:
            due = part.t + x[part.recording] + x[-1] * part.t
            inside = (due >= part.grid[0]) & (due <= part.grid[-1])
            rate = np.interp(due[inside], part.grid, part.rate[:, j])
            shift = np.zeros((len(rate), len(x)))
            shift[:, part.recording] = rate
            shift[:, -1] = rate * part.t[inside]
            torques.append(np.interp(due[inside], part.grid, part.torque[:, j]))
            owns.append(part.columns[inside, j])
            shifts.append(shift * free)
        tau, own, moved = (np.concatenate(y) for y in (torques, owns, shifts))
        basis = np.linalg.qr(own / np.maximum(np.abs(own).max(axis=0), SMALLEST))[0]
        # without what b explains of the torque and of its shifts
        rest, moved = (y - basis @ (basis.T @ y) for y in (tau, moved))
        # what an exact fit leaves is rounding
        whole = max(float(len(tau) * tau.var()), SMALLEST)
        square = max(float(rest @ rest), np.finfo(float).eps * whole)
        normal += moved.T @ moved / square
        right += moved.T @ rest / square
        left += np.log(square / whole) / joints
    if not np.isfinite(normal).all():  # numbers that no arm has
        return _Step(np.inf, 0.0, x, x, np.inf)
    inverse = np.linalg.pinv(normal, rcond=1e-9, hermitian=True)
    change = inverse @ right
    fall = float(change @ right) / joints
    return _Step(left, fall, x - change, x, float(inverse[-1, -1]) / len(tau))


# Quantisation of the encoders, read from the positions themselves.
#
# Noise before rounding leaves every position on a lattice, q = o + k s with whole k. The smallest distances between
# distinct values give a first step s; the share of values on the lattice decides whether there is one; a line
# through values against k gives the step with its standard deviation.


QUANTISATION, _ = of_quantity("resolution")


@dataclass(frozen=True)
class Quantisation(Fault):
    """No fault but an effect: it shows in the recordings themselves, and no reading brings back what was rounded.

    Attributes:
        joints: from 1.
        step: of each [rad].
    """

    name = QUANTISATION.name
    parameters = QUANTISATION.parameters
    joints: tuple[int, ...]
    step: tuple[float, ...]


def find_quantization(case: Case) -> tuple[FoundFault, ...]:
    """Quantisation on the joints whose step exceeds the data sheet's, as one finding; or none."""
    sheet = case.arm.encoder_step
    least = STEP_WITHOUT_DATA_SHEET * case.arm.per_radian
    if sheet is not None:
        least = np.full(case.arm.n_joints, STEP_OVER_DATA_SHEET * sheet)
    recordings = (*case.recordings, *case.judged)
    found = {}
    for joint in range(case.arm.n_joints):
        step = encoder_step(recordings, joint)
        if step is not None and step[0] > least[joint]:
            found[joint + 1] = step
    if not found:
        return ()
    steps, stds = zip(*found.values(), strict=True)
    quantisation = Quantisation(tuple(found), steps)
    return (FoundFault(quantisation, OBVIOUS_FAULT_PROBABILITY, {"step": stds}),)


def encoder_step(
    recordings: Iterable[Recording], joint: int
) -> tuple[float, float] | None:
    """Quantisation step of a joint, from 0, and its standard deviation [rad]; ``None`` if q lies on no lattice.

    Recordings have to agree; those in which the joint hardly moves do not count.
    """
    found = [lattice(r.q[:LATTICE_SAMPLES, joint]) for r in recordings]
    steps = [step for step in found if step is not None]
    if not steps:
        return None
    values, stds = np.array(steps).T
    agree = np.abs(values / float(np.median(values)) - 1) <= LATTICE_AGREEMENT
    # without a majority the lattices are chance
    if 2 * agree.sum() <= len(agree):
        return None
    weights = 1.0 / stds[agree] ** 2
    mean = (weights * values[agree]).sum() / weights.sum()
    return float(mean), float(weights.sum() ** -0.5)


def lattice(q: np.ndarray) -> tuple[float, float] | None:
    """Step of the lattice on which positions q [rad], (N,), lie, and its standard deviation; ``None`` for none."""
    largest = max(float(np.abs(q).max()), MIN_MOTION)
    resolution = 10.0 ** (np.floor(np.log10(largest)) - LOG_DIGITS)
    distances = np.diff(np.unique(q))
    distances = np.sort(distances[distances > 3 * resolution])
    if len(distances) < LATTICE_LEVELS:
        return None
    # guesses: the mean of the smallest that are alike, whether these are the step, rare glitches or a few of both
    smallest = (distances[0], *np.quantile(distances, (0.02, 0.5)))
    for small in smallest:
        width = max(0.1 * small, 2 * resolution)
        alike = distances[np.abs(distances - small) < width]
        step = _sharpened(q, float(alike.mean())) if len(alike) else None
        if step is not None:
            return step
    return None


def _sharpened(q: np.ndarray, step: float) -> tuple[float, float] | None:
    """The step refined over wider and wider stretches of positions, with its standard deviation.

    A line through the positions against the numbers of their levels gives it. ``None`` if they do not lie on the
    refined lattice.
    """
    centre = float(np.median(q))
    offset = q - q[np.argmin(np.abs(q - centre))]
    travel = float(np.abs(offset).max())
    reach = 8 * step  # near the centre even a rough step counts the levels rightly
    while True:
        near = offset[np.abs(offset) <= reach]
        count = np.round(near / step)
        if np.ptp(count) >= 1:
            slope = float(np.polyfit(count, near, 1)[0])
            if not abs(np.log(slope / step)) < LATTICE_AGREEMENT:
                return None
            step = slope
        if reach >= travel:
            break
        reach *= 2
    coherence = np.abs(np.exp(2j * np.pi * offset / step).mean())
    count = np.round(offset / step)
    if coherence < LATTICE_COHERENCE or len(np.unique(count)) < LATTICE_LEVELS:
        return None
    slope, start = np.polyfit(count, offset, 1)
    residual = offset - start - slope * count
    std = residual.std() / (count.std() * np.sqrt(len(offset)))
    return float(slope), float(max(std, SMALLEST))
