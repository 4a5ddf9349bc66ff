"""Trajectories: Fourier and other series over time, sampled ones, and how many samples they take."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from scipy.interpolate import BPoly

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.io.plausibility import PLAUSIBLE_RATES
from gapscope.arm.motions.motion import Motion

# How many samples a motion may have that is computed as a whole.


MAX_SAMPLES = 4_000_000
"""Samples in all, an hour at 1 kHz: of seven joints they take some GB while they are computed."""


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


_STEP = np.polynomial.Polynomial([0, 0, 0, 0, 35, -84, 70, -20])


class ReferenceMotion(Protocol):
    """A reference motion of n joints; each method takes times [s] of shape (N,) and returns shape (N, n)."""

    def position(self, t: np.ndarray) -> np.ndarray:
        """Position [rad]."""

    def velocity(self, t: np.ndarray) -> np.ndarray:
        """Velocity [rad/s]."""

    def acceleration(self, t: np.ndarray) -> np.ndarray:
        """Acceleration [rad/s^2]."""


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
    free = upper - lower > 1e3
    velocity = body.velocity_limits()
    velocity = np.where((velocity > 0) & (velocity < 1e3), velocity, size)
    return Limits(
        lower=np.where(free, -np.pi * size, lower + margin * size),
        upper=np.where(free, np.pi * size, upper - margin * size),
        velocity=velocity,
        acceleration=np.broadcast_to(
            np.asarray(acceleration, dtype=float), lower.shape
        ),
    )


@dataclass(frozen=True)
class Fourier:
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
        centre: np.ndarray | None = None,
        order: int = 5,
        frequency: float = 0.1,
        ramp: float = 1.0,
    ) -> Fourier:
        """A random motion, per joint as large as the limits allow at every sample of 1 ms.

        Args:
            rng: source of the coefficients, each normal with variance 1 / k^2.
            limits: position, velocity and acceleration limits.
            duration: [s], at least twice ``ramp``.
            centre: q0 [rad], shape (n,); the middle of the position limits if ``None``.
            order: number of harmonics.
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
        harmonics = np.arange(1, order + 1)[:, None]
        sine, cosine = rng.standard_normal((2, order, len(centre))) / harmonics
        unit = cls(np.zeros_like(centre), sine, cosine, frequency, duration, ramp)
        # the motion is linear in its coefficients, so the tightest limit gives their scale
        t = np.linspace(0.0, duration, round(1e3 * duration) + 1)
        by_position = room / np.abs(unit.position(t)).max(axis=0)
        by_velocity = limits.velocity / np.abs(unit.velocity(t)).max(axis=0)
        by_acceleration = limits.acceleration / np.abs(unit.acceleration(t)).max(axis=0)
        scale = np.min([by_position, by_velocity, by_acceleration], axis=0)
        return cls(centre, scale * sine, scale * cosine, frequency, duration, ramp)

    def position(self, t: np.ndarray) -> np.ndarray:
        """Position [rad] at times t [s] of shape (N,); shape (N, n)."""
        return self.centre + self._window(t, 0) * self._series(t, 0)

    def velocity(self, t: np.ndarray) -> np.ndarray:
        """Velocity [rad/s] at times t [s] of shape (N,); shape (N, n)."""
        window, series = self._window, self._series
        return window(t, 1) * series(t, 0) + window(t, 0) * series(t, 1)

    def acceleration(self, t: np.ndarray) -> np.ndarray:
        """Acceleration [rad/s^2] at times t [s] of shape (N,); shape (N, n)."""
        window, series = self._window, self._series
        return (
            window(t, 2) * series(t, 0)
            + 2 * window(t, 1) * series(t, 1)
            + window(t, 0) * series(t, 2)
        )

    def _series(self, t: np.ndarray, derivative: int) -> np.ndarray:
        omega = 2 * np.pi * self.frequency * np.arange(1, len(self.sine) + 1)
        phase = np.multiply.outer(t, omega) + derivative * np.pi / 2
        gain = omega[:, None] ** derivative
        return np.sin(phase) @ (gain * self.sine) + np.cos(phase) @ (gain * self.cosine)

    def _window(self, t: np.ndarray, derivative: int) -> np.ndarray:
        t = np.asarray(t, dtype=float)
        step = _STEP.deriv(derivative)
        rise = t / self.ramp
        fall = (self.duration - t) / self.ramp
        rising = step(np.clip(rise, 0, 1))
        # time runs backwards along the falling flank
        falling = (-1) ** derivative * step(np.clip(fall, 0, 1))
        flank = np.where(rise < fall, rising, falling)
        return (flank / self.ramp**derivative)[:, None]


# A reference motion from samples in a file, such as an exciting trajectory.


@dataclass(frozen=True)
class Sampled:
    """A motion through samples of position, velocity and acceleration, quintic in between; it rests before and after.

    Attributes:
        motion: the samples, N of n joints; time starts at 0 [s].

    Raises:
        InputError: fewer than two samples, or a time that does not start at 0 and rise.
    """

    motion: Motion

    def __post_init__(self) -> None:
        """Check the time."""
        t = self.motion.t
        if len(t) < 2 or t[0] != 0 or not (np.diff(t) > 0).all():
            raise InputError(
                "a motion needs two or more samples whose time starts at 0 and rises",
                where="t",
            )

    def slower(self, speed: float) -> Sampled:
        """The same path at ``speed`` times the speed [1]."""
        m = self.motion
        return Sampled(Motion(m.t / speed, m.q, speed * m.dq, speed**2 * m.ddq))

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.motion.t[-1])

    @cached_property
    def _curve(self) -> BPoly:
        # Bernstein coefficients of all steps at once, from both ends inwards
        m, h = self.motion, np.diff(self.motion.t)[:, None]
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
        return BPoly(np.stack(start + end), m.t)

    def position(self, t: np.ndarray) -> np.ndarray:
        """Position [rad] at times t [s] of shape (N,); shape (N, n)."""
        return self._curve(np.clip(t, 0.0, self.duration))

    def velocity(self, t: np.ndarray) -> np.ndarray:
        """Velocity [rad/s] at times t [s] of shape (N,); shape (N, n)."""
        return self._inside(t) * self._curve(np.clip(t, 0.0, self.duration), 1)

    def acceleration(self, t: np.ndarray) -> np.ndarray:
        """Acceleration [rad/s^2] at times t [s] of shape (N,); shape (N, n)."""
        return self._inside(t) * self._curve(np.clip(t, 0.0, self.duration), 2)

    def _inside(self, t: np.ndarray) -> np.ndarray:
        return ((np.asarray(t) >= 0) & (np.asarray(t) <= self.duration))[:, None]


def read_sampled(path: Path, n_joints: int) -> Sampled:
    """A reference motion from a CSV with columns ``t``, ``q_ref1..``, ``dq_ref1..`` and ``ddq_ref1..``.

    Raises:
        InputError: the file or a column is missing, or a value is no finite number.
    """
    # most commands read no reference, and would wait for it
    import pandas as pd

    remedy = "give a file as gapscope excite writes it"
    try:
        table = pd.read_csv(path)
    except FileNotFoundError:
        raise InputError("no such file", remedy, file=path) from None
    except (OSError, ValueError) as error:
        raise InputError(
            f"cannot be read as CSV ({error})", remedy, file=path
        ) from None
    joints = range(1, n_joints + 1)
    columns = [
        "t",
        *(f"{name}{j}" for name in ("q_ref", "dq_ref", "ddq_ref") for j in joints),
    ]
    missing = [column for column in columns if column not in table]
    if missing:
        raise InputError(f"has no column {', '.join(missing[:4])}", remedy, file=path)
    used = table[columns].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=float)
    if not np.isfinite(used).all():
        row = int(np.flatnonzero(~np.isfinite(used).all(axis=1))[0])
        raise InputError(
            "holds a value that is no finite number",
            remedy,
            file=path,
            where=f"line {row + 2}",
        )
    return Sampled(Motion(used[:, 0], *np.split(used[:, 1:], 3, axis=1)))


# Motions made of motions: one after the other, and backwards.


class Timed(ReferenceMotion, Protocol):
    """A reference motion that rests outside [0, duration]."""

    @property
    def duration(self) -> float:
        """Duration [s]."""


@dataclass(frozen=True)
class Chain:
    """Motions that follow each other, each beginning where the one before it rests.

    Attributes:
        parts: the motions.
    """

    parts: tuple[Timed, ...]

    @property
    def duration(self) -> float:
        """Sum of the parts' durations [s]."""
        return float(sum(part.duration for part in self.parts))

    def position(self, t: np.ndarray) -> np.ndarray:
        """Position [rad] at times t [s] of shape (N,); shape (N, n)."""
        return self._evaluate("position", t)

    def velocity(self, t: np.ndarray) -> np.ndarray:
        """Velocity [rad/s] at times t [s] of shape (N,); shape (N, n)."""
        return self._evaluate("velocity", t)

    def acceleration(self, t: np.ndarray) -> np.ndarray:
        """Acceleration [rad/s^2] at times t [s] of shape (N,); shape (N, n)."""
        return self._evaluate("acceleration", t)

    def _evaluate(self, quantity: str, t: np.ndarray) -> np.ndarray:
        t = np.asarray(t, dtype=float)
        durations = [part.duration for part in self.parts]
        ends = np.cumsum(durations)
        part_of = np.searchsorted(ends[:-1], t, side="right")
        n = self.parts[0].position(np.zeros(1)).shape[1]
        out = np.empty((len(t), n))
        for index in np.unique(part_of):
            rows = part_of == index
            begin = ends[index] - durations[index]
            evaluate = getattr(self.parts[index], quantity)
            out[rows] = evaluate(t[rows] - begin)
        return out


@dataclass(frozen=True)
class Reversed:
    """A motion run backwards: q(T - t).

    Attributes:
        forward: the motion.
    """

    forward: Timed

    @property
    def duration(self) -> float:
        """Duration T [s]."""
        return self.forward.duration

    def position(self, t: np.ndarray) -> np.ndarray:
        """Position [rad] at times t [s] of shape (N,); shape (N, n)."""
        return self.forward.position(self.duration - t)

    def velocity(self, t: np.ndarray) -> np.ndarray:
        """Velocity [rad/s] at times t [s] of shape (N,); shape (N, n)."""
        return -self.forward.velocity(self.duration - t)

    def acceleration(self, t: np.ndarray) -> np.ndarray:
        """Acceleration [rad/s^2] at times t [s] of shape (N,); shape (N, n)."""
        return self.forward.acceleration(self.duration - t)
