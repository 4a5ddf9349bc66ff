"""Trajectories: Fourier series, samples of a file, quintics, chains of them; and how many samples they take."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import comb
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from scipy.interpolate import BPoly, PPoly, make_interp_spline

from gapscope.arm.dynamics.rigid_body import UNLIMITED, RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.io.log import open_log
from gapscope.arm.io.plausibility import MAX_SAMPLES, PLAUSIBLE_RATES
from gapscope.arm.motions.motion import Motion

# How many samples a motion may have that is computed as a whole.


def check_sample_count(duration: float, rate: float, recordings: int = 1) -> None:
    """Check that motions of a duration [s] at a rate [Hz] can be held in memory.

    Raises:
        InputError: the rate is beyond any robot's, or there are more than ``MAX_SAMPLES``.
    """
    highest = PLAUSIBLE_RATES[1]
    if rate > highest:
        raise InputError(
            f"{rate:g} Hz is beyond any robot's log",
            f"give {highest:g} Hz or less",
            where="rate",
        )
    if duration * rate * recordings > MAX_SAMPLES:
        raise InputError(
            f"{recordings} x {duration:g} s at {rate:g} Hz are {duration * rate * recordings:.3g} samples, at most "
            f"{MAX_SAMPLES:,} are made at once",
            "give a shorter duration, a lower rate or fewer recordings",
            where="duration",
        )


# Reference motions: smooth joint trajectories within limits.


class ReferenceMotion(Protocol):
    """A reference motion of n joints; each method takes times [s] of shape (N,) and returns shape (N, n)."""

    def position(self, t: np.ndarray) -> np.ndarray:
        """Position [rad]."""

    def velocity(self, t: np.ndarray) -> np.ndarray:
        """Velocity [rad/s]."""

    def acceleration(self, t: np.ndarray) -> np.ndarray:
        """Acceleration [rad/s^2]."""


def motion_of(reference: ReferenceMotion, t: np.ndarray) -> Motion:
    """A reference at uniform times [s], shape (N,); before 0 it rests where it starts."""
    held, moves = np.maximum(t, 0.0), (t >= 0)[:, None]
    velocity, acceleration = reference.velocity(held), reference.acceleration(held)
    return Motion(t, reference.position(held), moves * velocity, moves * acceleration)


class Timed(ReferenceMotion):
    """A reference motion that rests outside [0, duration].

    Attributes:
        duration: [s].
    """

    duration: float

    @abstractmethod
    def derivative(self, t: np.ndarray, order: int) -> np.ndarray:
        """d^k q / dt^k [rad/s^k], k = 0, 1 or 2, at times t [s] of shape (N,); shape (N, n)."""

    def position(self, t: np.ndarray) -> np.ndarray:
        """Position [rad] at times t [s] of shape (N,); shape (N, n)."""
        return self.derivative(np.asarray(t), 0)

    def velocity(self, t: np.ndarray) -> np.ndarray:
        """Velocity [rad/s] at times t [s] of shape (N,); shape (N, n)."""
        return self.derivative(np.asarray(t), 1)

    def acceleration(self, t: np.ndarray) -> np.ndarray:
        """Acceleration [rad/s^2] at times t [s] of shape (N,); shape (N, n)."""
        return self.derivative(np.asarray(t), 2)


class Limits(NamedTuple):
    """What a reference motion must keep, each of shape (n,): rad, rad, rad/s, rad/s^2."""

    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


def urdf_limits(
    body: RigidBody, acceleration: np.ndarray | float, *, margin: float = 0.05
) -> Limits:
    """Limits of a URDF, which has none for the acceleration [rad/s^2].

    Args:
        body: rigid-body model of the arm.
        acceleration: limit of the acceleration [rad/s^2], one number or shape (n,).
        margin: distance kept from the position limits [rad].

    A joint without position limits moves within +-pi, one without a velocity limit within 1 rad/s; of a slide the
    margin and these limits count in what counts as a radian, ``NominalArm.per_radian``.
    """
    (lower, upper), size = body.position_limits(), body.per_radian
    free = ~np.isfinite(upper - lower)
    velocity = body.velocity_limits()
    velocity = np.where((velocity > 0) & (velocity < UNLIMITED), velocity, size)
    return Limits(
        lower=np.where(free, -np.pi * size, lower + margin * size),
        upper=np.where(free, np.pi * size, upper - margin * size),
        velocity=velocity,
        acceleration=np.broadcast_to(
            np.asarray(acceleration, dtype=float), lower.shape
        ),
    )


HARMONICS = 5
"""Of a random Fourier series."""
_WINDOW = BPoly.from_derivatives([0, 1], [[0, 0, 0, 0], [1, 0, 0, 0]])
"""35 x^4 - 84 x^5 + 70 x^6 - 20 x^7: from 0 to 1, with three derivatives of zero at both ends."""


@dataclass(frozen=True)
class Fourier(Timed):
    """A windowed Fourier series, q(t) = q0 + w(t) sum_k (a_k sin(2 pi k f t) + b_k cos(2 pi k f t)).

    The window w rises from 0 to 1 within ``ramp`` seconds and falls back before the end, by the polynomial
    35 x^4 - 84 x^5 + 70 x^6 - 20 x^7, so that the motion starts and ends at rest with continuous jerk. Outside
    [0, duration] it rests at q0.

    Attributes:
        centre: q0 [rad], shape (n,).
        sine, cosine: a and b [rad], shape (order, n).
        frequency: f [Hz].
        duration: [s].
        ramp: length of the window's flanks [s].
    """

    centre: np.ndarray
    sine: np.ndarray
    cosine: np.ndarray
    frequency: float
    duration: float
    ramp: float

    @classmethod
    def random(
        cls,
        rng: np.random.Generator,
        limits: Limits,
        *,
        duration: float,
        frequency: float,
        centre: np.ndarray | None = None,
        ramp: float = 1.0,
    ) -> Fourier:
        """A random motion, per joint as large as the limits allow at every sample of 1 ms.

        Args:
            rng: source of the coefficients, each normal with variance 1 / k^2.
            limits: position, velocity and acceleration limits.
            duration: [s], at least twice ``ramp``.
            centre: q0 [rad], shape (n,); the middle of the position limits if ``None``.
            frequency: base frequency f [Hz].
            ramp: length of the window's flanks [s].

        Raises:
            InputError: the centre lies outside the limits, or the duration is too short for the window.
        """
        if duration < 2 * ramp:
            raise InputError(
                f"a motion of {duration} s cannot rise and fall in {ramp} s each",
                where="duration",
            )
        if centre is None:
            centre = (limits.lower + limits.upper) / 2
        centre = np.asarray(centre, dtype=float)
        room = np.minimum(limits.upper - centre, centre - limits.lower)
        if (room <= 0).any():
            raise InputError(
                f"joint {int(room.argmin()) + 1} lies outside its limits",
                where="centre",
            )
        harmonics = np.arange(1, HARMONICS + 1)[:, None]
        # 1 / k: high harmonics would take up the acceleration and make no way
        sine, cosine = rng.standard_normal((2, HARMONICS, len(centre))) / harmonics
        unit = cls(np.zeros_like(centre), sine, cosine, frequency, duration, ramp)
        # the motion is linear in its coefficients, so the tightest limit gives their scale
        t = np.linspace(0.0, duration, round(1e3 * duration) + 1)
        by_position = room / np.abs(unit.position(t)).max(axis=0)
        by_velocity = limits.velocity / np.abs(unit.velocity(t)).max(axis=0)
        by_acceleration = limits.acceleration / np.abs(unit.acceleration(t)).max(axis=0)
        scale = np.min([by_position, by_velocity, by_acceleration], axis=0)
        return cls(centre, scale * sine, scale * cosine, frequency, duration, ramp)

    def derivative(self, t: np.ndarray, order: int) -> np.ndarray:
        """By the product rule of window and series."""
        out = np.zeros((len(t), len(self.centre)))
        # Leibniz: sum over k of (order over k) w^(order - k) s^(k)
        for k in range(order + 1):
            out += comb(order, k) * self._window(t, order - k) * self._series(t, k)
        return out if order else self.centre + out

    def _series(self, t: np.ndarray, derivative: int) -> np.ndarray:
        omega = 2 * np.pi * self.frequency * np.arange(1, len(self.sine) + 1)
        # each derivative turns the phase by a quarter and multiplies by the frequency
        phase = np.multiply.outer(t, omega) + derivative * np.pi / 2
        gain = omega[:, None] ** derivative
        return np.sin(phase) @ (gain * self.sine) + np.cos(phase) @ (gain * self.cosine)

    def _window(self, t: np.ndarray, derivative: int) -> np.ndarray:
        # time runs backwards along the falling flank
        rate = np.where(t < self.duration - t, 1, -1) / self.ramp
        flank = np.minimum(t, self.duration - t) / self.ramp
        step = _WINDOW(np.clip(flank, 0, 1), derivative)
        return np.asarray(step * rate**derivative)[:, None]


@dataclass(frozen=True)
class Curve(Timed):
    """A motion that a curve over time describes between its ends, where it rests.

    Attributes:
        of: d^k q / dt^k [rad/s^k], (N, n), of times [s], (N,), from 0 to the duration, and k.
        duration: [s].
    """

    of: Callable[[np.ndarray, int], np.ndarray]
    duration: float

    def derivative(self, t: np.ndarray, order: int) -> np.ndarray:
        """That of the curve; 0 outside."""
        # at rest beyond its ends, in position too
        found = self.of(np.clip(t, 0.0, self.duration), order)
        return found * ((t >= 0) & (t <= self.duration))[:, None] if order else found


def point_to_point(start: np.ndarray, end: np.ndarray, duration: float) -> Curve:
    """A straight line in joint space, q(t) = a + s(t / T) (b - a) with s(x) = 10 x^3 - 15 x^4 + 6 x^5 [biagiotti2008].

    Velocity and acceleration vanish at both ends; outside [0, T] the arm rests.

    Args:
        start, end: postures a and b [rad], shape (n,).
        duration: T [s].

    Raises:
        InputError: a duration that is not positive.
    """
    if not duration > 0:
        raise InputError(f"{duration} s is not a positive duration", where="duration")
    # of the ends position, velocity and acceleration
    rest = np.zeros_like(start)
    ends = [[start, rest, rest], [end, rest, rest]]
    return Curve(BPoly.from_derivatives([0.0, duration], ends), duration)


def fastest(start: np.ndarray, end: np.ndarray, limits: Limits) -> Curve:
    """The fastest such motion within limits of velocity and acceleration; at least ``SHORTEST``.

    Raises:
        InputError: an end lies outside the position limits.
    """
    for label, q in (("start", start), ("end", end)):
        outside = (q < limits.lower) | (q > limits.upper)
        if outside.any():
            joint = int(outside.argmax())
            low, high = limits.lower[joint], limits.upper[joint]
            raise InputError(
                f"{q[joint]:.4g} rad lies outside {low:.4g} .. {high:.4g} rad",
                where=f"{label}, joint {joint + 1}",
            )
    way = np.abs(end - start)
    # of the way, by s' = 15/8 in its middle and s'' = 10 / sqrt 3 at most
    speed, acceleration = _PEAKS
    least = shortest(speed * way, acceleration * way, limits)
    return point_to_point(start, end, max(least, SHORTEST))


_STEP = PPoly.from_bernstein_basis(
    BPoly.from_derivatives([0, 1], [[0, 0, 0], [1, 0, 0]])
)
"""s over [0, 1]."""
_PEAKS = [np.abs(_STEP(_STEP.derivative(k + 1).roots(), k)).max() for k in (1, 2)]
"""Largest s' and s'', where the next derivative is zero."""
SHORTEST = 0.1
"""Duration of the shortest motion between two postures, or along a line [s]."""


def shortest(speed: np.ndarray, acceleration: np.ndarray, limits: Limits) -> float:
    """Shortest duration [s] within limits of a motion that has these peaks if it lasts for one second, (n,) each."""
    # T times as long: velocity falls with T, acceleration with T^2
    by_acceleration = np.sqrt(acceleration / limits.acceleration)
    return float(np.maximum(speed / limits.velocity, by_acceleration).max())


def way_points(times: np.ndarray, points: np.ndarray) -> Curve:
    """The quintic spline through way points, at rest and without acceleration at both ends; it rests outside its time.

    It has four continuous derivatives [biagiotti2008].

    Args:
        times: when the way points are passed [s], from 0 on, shape (M,).
        points: way points [rad], shape (M, n).

    Raises:
        InputError: times that do not start at 0 or do not rise, fewer than two way points, or another number of them.
    """
    if len(times) != len(points):
        raise InputError(
            f"{len(points)} way points at {len(times)} times",
            "give two or more, each with its time",
            where="points",
        )
    _check_times(times, "way points")
    rest = [(order, np.zeros(points.shape[1])) for order in (1, 2)]
    spline = make_interp_spline(times, points, k=5, bc_type=(rest, rest))
    return Curve(spline, float(times[-1]))


def _check_times(t: np.ndarray, what: str) -> None:
    if len(t) < 2 or t[0] != 0 or not (np.diff(t) > 0).all():
        raise InputError(
            f"a motion needs two or more {what} whose time starts at 0 and rises",
            where="t",
        )


# A reference motion from samples in a file, such as an exciting trajectory.


@dataclass(frozen=True)
class Sampled(Timed):
    """A motion through samples of position, velocity and acceleration, quintic in between; it rests before and after.

    Attributes:
        motion: the samples, N of n joints; time starts at 0 [s].

    Raises:
        InputError: fewer than two samples, or a time that does not start at 0 and rise.
    """

    motion: Motion

    def __post_init__(self) -> None:
        """Check the time."""
        _check_times(self.motion.t, "samples")

    def slower(self, speed: float) -> Sampled:
        """The same path at ``speed`` times the speed [1]."""
        m = self.motion
        return Sampled(Motion(m.t / speed, m.q, speed * m.dq, speed**2 * m.ddq))

    @property
    def duration(self) -> float:  # type: ignore[override]
        """Time of the last sample [s]."""
        return float(self.motion.t[-1])

    @cached_property
    def curve(self) -> Curve:
        """By the Bernstein coefficients of all steps at once, from both ends inwards."""
        m, h = self.motion, np.diff(self.motion.t)[:, None]
        # of a step h: q, q + h dq / 5, q + 2 h dq / 5 + h^2 ddq / 20
        speed, bend = m.dq / 5, m.ddq / 20
        start = [
            m.q[:-1],
            m.q[:-1] + h * speed[:-1],
            m.q[:-1] + 2 * h * speed[:-1] + h**2 * bend[:-1],
        ]
        end = [
            m.q[1:] - 2 * h * speed[1:] + h**2 * bend[1:],
            m.q[1:] - h * speed[1:],
            m.q[1:],
        ]
        return Curve(BPoly(np.stack(start + end), m.t), self.duration)

    def derivative(self, t: np.ndarray, order: int) -> np.ndarray:
        """That of the curve."""
        return self.curve.derivative(t, order)


def read_sampled(path: Path, n_joints: int) -> Sampled:
    """A reference motion from a CSV with columns ``t``, ``q_ref1..``, ``dq_ref1..`` and ``ddq_ref1..``.

    Raises:
        InputError: the file or a column is missing, or a value is no finite number.
    """
    names = [
        f"{x}{j + 1}" for x in ("q_ref", "dq_ref", "ddq_ref") for j in range(n_joints)
    ]
    try:
        table = open_log(path).tables[0]
        used = np.column_stack([table.numbers(name) for name in ("t", *names)])
    except InputError as error:
        remedy = "give a file as gapscope excite writes it"
        raise InputError(
            error.problem, remedy, file=error.file, where=error.where
        ) from None
    return Sampled(Motion(used[:, 0], *np.split(used[:, 1:], 3, axis=1)))


# Motions made of motions: one after the other, and backwards.


def chain(parts: Sequence[Timed]) -> Curve:
    """Motions that follow each other, each beginning where the one before it rests."""
    ends = np.cumsum([part.duration for part in parts])

    def joined(t: np.ndarray, order: int) -> np.ndarray:
        """That of the part at each time."""
        # the last part also takes what lies beyond its end, where it rests
        part_of = np.searchsorted(ends[:-1], t, side="right")
        out = np.empty((len(t), parts[0].position(np.zeros(1)).shape[1]))
        for index in np.unique(part_of):
            rows, part = part_of == index, parts[index]
            out[rows] = part.derivative(t[rows] - (ends[index] - part.duration), order)
        return out

    return Curve(joined, float(ends[-1]))


def backwards(forward: Timed) -> Curve:
    """A motion run backwards, q(T - t); each derivative changes the sign."""

    def turned(t: np.ndarray, order: int) -> np.ndarray:
        """That of the forward motion."""
        return (-1) ** order * forward.derivative(forward.duration - t, order)

    return Curve(turned, forward.duration)
