"""Reference motions: smooth joint trajectories within limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError

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
