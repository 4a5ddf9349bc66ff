"""Point to point: from one posture to another, at rest at both ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.motions.trajectory import Limits

_QUINTIC = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
_DERIVATIVES = tuple(_QUINTIC.deriv(k) for k in range(3))
PEAK_SPEED = 15 / 8
"""Largest s' of the quintic s(x) = 10 x^3 - 15 x^4 + 6 x^5."""
PEAK_ACCELERATION = 10 / np.sqrt(3)
"""Largest s'' of it."""


@dataclass(frozen=True)
class PointToPoint:
    """A straight line in joint space, q(t) = a + s(t / T) (b - a) with s(x) = 10 x^3 - 15 x^4 + 6 x^5 [biagiotti2008].

    Velocity and acceleration vanish at both ends; outside [0, T] the arm rests.

    Attributes:
        start, end: postures a and b [rad], shape (n,).
        duration: T [s].

    Raises:
        InputError: a duration that is not positive.
    """

    start: np.ndarray
    end: np.ndarray
    duration: float

    def __post_init__(self) -> None:
        """Check the duration."""
        if not self.duration > 0:
            raise InputError(
                f"{self.duration} s is not a positive duration", where="duration"
            )

    @classmethod
    def within(cls, start: np.ndarray, end: np.ndarray, limits: Limits) -> PointToPoint:
        """The fastest such motion within limits of velocity and acceleration; at least 0.1 s.

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
        by_speed = PEAK_SPEED * way / limits.velocity
        by_acceleration = np.sqrt(PEAK_ACCELERATION * way / limits.acceleration)
        fastest = np.maximum(by_speed, by_acceleration).max()
        return cls(start, end, max(float(fastest), 0.1))

    def position(self, t: np.ndarray) -> np.ndarray:
        """Position [rad] at times t [s] of shape (N,); shape (N, n)."""
        return self.start + self._progress(t, 0) * (self.end - self.start)

    def velocity(self, t: np.ndarray) -> np.ndarray:
        """Velocity [rad/s] at times t [s] of shape (N,); shape (N, n)."""
        return self._progress(t, 1) * (self.end - self.start)

    def acceleration(self, t: np.ndarray) -> np.ndarray:
        """Acceleration [rad/s^2] at times t [s] of shape (N,); shape (N, n)."""
        return self._progress(t, 2) * (self.end - self.start)

    def _progress(self, t: np.ndarray, derivative: int) -> np.ndarray:
        x = np.clip(np.asarray(t, dtype=float) / self.duration, 0.0, 1.0)
        return (_DERIVATIVES[derivative](x) / self.duration**derivative)[:, None]
