"""A torque whose clock runs at another rate than the motion's: late by more and more, or early.

Two loggers, or two nodes of a bus, whose clocks differ by a share s: the torque that belongs to the motion at t was
recorded at t + d + s (t - t_0). Both are found by Gauss-Newton steps, the torque of each joint explained by that of
the nominal bodies and of friction, each with a free factor,

    tau(t + d + s (t - t_0)) = X b,  X = [gravity, the rest of the bodies' torque, a, sgn v, v, 1],

with s the same for all recordings and joints, and d its own for each recording.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.recording import Recording
from gapscope.diagnosis.setup_faults.found_fault import FoundFault
from gapscope.diagnosis.thresholds import (
    CLOCK_GAIN,
    CLOCK_HINT,
    CLOCK_LEAST_SKEW,
    CLOCK_ROUNDS,
    CLOCK_SAMPLES,
    FAULT_SIGN_WIDTH,
    MOST_CLOCK_SHARE,
    OBVIOUS_FAULT_PROBABILITY,
    STAMP_AMOUNT_STD,
)
from gapscope.effects.setup_faults.time_stamp_fault import TimeStamps
from gapscope.model.conditioning import (
    TORQUE_CUTOFF,
    Segment,
    condition,
    low_pass,
)

TORQUE_CLOCK = "torque_clock"
"""The variant of ``time_stamps``."""


@dataclass(frozen=True)
class _Samples:
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


@dataclass(frozen=True)
class _Clock:
    """Delays d of R recordings [s], (R,), and the share s [1]."""

    delay: np.ndarray
    share: float = 0.0


@dataclass(frozen=True)
class _Step:
    """A Gauss-Newton step from a clock.

    Attributes:
        clock: where it begins.
        left: logarithm of what X leaves of the torque's variance there, mean over joints [1].
        fall: share of that which the step promises to take away [1].
        to: where it leads.
    """

    clock: _Clock
    left: float
    fall: float
    to: _Clock


def find_torque_clock(case: Case) -> FoundFault | None:
    """The torque's clock as a fault of the time stamps, ``amount`` 1 + s; ``None`` if it keeps up."""
    recordings = tuple(r for r in case.recordings if r.tau is not None)
    try:
        samples = _samples(case, recordings)
    except (GapscopeError, ValueError):
        # too short or too odd to be conditioned; what needs the signals says so
        return None
    if not samples:
        return None
    even = _Clock(np.zeros(len(recordings)))
    first = _step(samples, even)
    if first.fall - _step(samples, even, drifts=False).fall < CLOCK_HINT:
        return None
    starts = [_Clock(even.delay, k * first.to.share) for k in (1.0, 2.0, 4.0)]
    best = min((_best(samples, start) for start in starts), key=lambda s: s.left)
    share, longest = best.clock.share, max(float(part.t[-1]) for part in samples)
    delayed = _best(samples, even, drifts=False)
    if best.left > delayed.left - CLOCK_GAIN or abs(share) > MOST_CLOCK_SHARE:
        return None
    if abs(share) * longest < CLOCK_LEAST_SKEW:
        return None
    std = max(0.1 * CLOCK_LEAST_SKEW / longest, STAMP_AMOUNT_STD * abs(share))
    every = (*case.recordings, *case.judged)
    return FoundFault(
        TimeStamps(TORQUE_CLOCK, 1.0 + share),
        OBVIOUS_FAULT_PROBABILITY,
        {"amount": (std,)},
        tuple(r.name for r in every if r.tau is not None),
    )


def _samples(case: Case, recordings: tuple[Recording, ...]) -> list[_Samples]:
    """Samples of the recordings with a torque."""
    if not recordings:
        return []
    body = RigidBody(case.arm)
    pieces = [
        (k, float(recording.t[0]), segment)
        for k, recording in enumerate(recordings)
        for segment in condition(recording)
    ]
    rows = sum(len(segment.motion.t[segment.inner]) for _, _, segment in pieces)
    step = max(1, rows // CLOCK_SAMPLES)
    return [_of_segment(body, segment, k, start, step) for k, start, segment in pieces]


def _of_segment(
    body: RigidBody, segment: Segment, recording: int, start: float, step: int
) -> _Samples:
    m, inner = segment.motion, segment.inner
    assert segment.torque is not None
    torque = low_pass(segment.torque, m.rate, TORQUE_CUTOFF)
    q, dq, ddq = (x[inner][::step] for x in (m.q, m.dq, m.ddq))
    bodies, still = segment.bodies(body), np.zeros_like(q)
    gravity = bodies.inverse_dynamics(q, still, still)
    rest = bodies.inverse_dynamics(q, dq, ddq) - gravity
    dry = np.tanh(dq / FAULT_SIGN_WIDTH)
    columns = [gravity, rest, ddq, dry, dq, np.ones_like(q)]
    return _Samples(
        m.t[inner][::step] - start,
        np.stack(columns, axis=2),
        m.t - start,
        torque,
        np.gradient(torque, m.t, axis=0),
        recording,
    )


def _best(samples: list[_Samples], start: _Clock, drifts: bool = True) -> _Step:
    """The best of some steps, one after the other."""
    steps = [_step(samples, start, drifts)]
    for _ in range(CLOCK_ROUNDS):
        steps.append(_step(samples, steps[-1].to, drifts))
    return min(steps, key=lambda step: step.left)


def _step(samples: list[_Samples], clock: _Clock, drifts: bool = True) -> _Step:
    """A Gauss-Newton step; joints count by how well X explains them. ``drifts``: whether s is free."""
    joints, recordings = samples[0].torque.shape[1], len(clock.delay)
    normal, right = np.zeros((recordings + 1, recordings + 1)), np.zeros(recordings + 1)
    left = np.zeros(joints)
    for j in range(joints):
        tau, own, shifts = _rows(samples, clock, j)
        shifts[:, -1] *= drifts
        basis = np.linalg.qr(own / np.maximum(np.abs(own).max(axis=0), 1e-12))[0]
        # what b explains of the torque and of its shifts
        shifts = shifts - basis @ (basis.T @ shifts)
        rest = tau - basis @ (basis.T @ tau)
        square = max(float(rest @ rest), 1e-12)
        normal += shifts.T @ shifts / square
        right += shifts.T @ rest / square
        left[j] = square / max(len(tau) * float(tau.var()), 1e-12)
    if not np.isfinite(normal).all():  # numbers that no arm has
        return _Step(clock, np.inf, 0.0, clock)
    change = np.linalg.lstsq(normal, right, rcond=1e-9)[0]
    to = _Clock(clock.delay - change[:-1], clock.share - float(change[-1]))
    return _Step(clock, float(np.log(left).mean()), float(change @ right) / joints, to)


def _rows(
    samples: list[_Samples], clock: _Clock, j: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Torque of joint j by a clock, (M,), its X, (M, 6), and its derivatives by all d and s, (M, R + 1)."""
    torques, owns, shifts = [], [], []
    for part in samples:
        due = part.t + clock.delay[part.recording] + clock.share * part.t
        inside = (due >= part.grid[0]) & (due <= part.grid[-1])
        rate = np.interp(due[inside], part.grid, part.rate[:, j])
        shift = np.zeros((len(rate), len(clock.delay) + 1))
        shift[:, part.recording] = rate
        shift[:, -1] = rate * part.t[inside]
        torques.append(np.interp(due[inside], part.grid, part.torque[:, j]))
        owns.append(part.columns[inside, j])
        shifts.append(shift)
    return np.concatenate(torques), np.concatenate(owns), np.concatenate(shifts)
