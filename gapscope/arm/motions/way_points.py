"""A smooth motion through way points: a quintic spline, at rest at both ends."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from gapscope.arm.errors import InputError


def clamped_quintic(times: np.ndarray, values: np.ndarray) -> BSpline:
    """The quintic spline through values, (M, n), at times [s], (M,), at rest and without acceleration at both ends.

    It has four continuous derivatives [biagiotti2008].
    """
    rest = [(1, np.zeros(values.shape[1])), (2, np.zeros(values.shape[1]))]
    return make_interp_spline(times, values, k=5, bc_type=(rest, rest))


@dataclass(frozen=True)
class WayPoints:
    """A quintic spline through way points; outside its time it rests at the first and the last of them.

    Attributes:
        times: when the way points are passed [s], from 0 on, shape (M,).
        points: way points [rad], shape (M, n).

    Raises:
        InputError: times that do not start at 0 or do not rise, fewer than two way points, or another number of them.
    """

    times: np.ndarray
    points: np.ndarray

    def __post_init__(self) -> None:
        """Check the shapes."""
        if len(self.times) != len(self.points) or len(self.times) < 2:
            raise InputError(
                f"{len(self.points)} way points at {len(self.times)} times",
                "give two or more, each with its time",
                where="points",
            )
        if self.times[0] != 0 or (np.diff(self.times) <= 0).any():
            raise InputError("times have to start at 0 and to rise", where="times")

    @property
    def duration(self) -> float:
        """Time of the last way point [s]."""
        return float(self.times[-1])

    @cached_property
    def _spline(self) -> BSpline:
        return clamped_quintic(self.times, self.points)

    def position(self, t: np.ndarray) -> np.ndarray:
        """Position [rad] at times t [s] of shape (N,); shape (N, n)."""
        return self._spline(np.clip(t, 0.0, self.duration))

    def velocity(self, t: np.ndarray) -> np.ndarray:
        """Velocity [rad/s] at times t [s] of shape (N,); shape (N, n)."""
        return self._spline(np.clip(t, 0.0, self.duration), 1)

    def acceleration(self, t: np.ndarray) -> np.ndarray:
        """Acceleration [rad/s^2] at times t [s] of shape (N,); shape (N, n)."""
        return self._spline(np.clip(t, 0.0, self.duration), 2)
