"""Series over time, shifted, differentiated and lagged, as the laws on the way to the joint need them."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import lfilter

from gapscope.arm.motions.motion import Motion


class MotionSeries:
    """The ``gapscope.effects.effect.Series`` of a motion; series have the shape (N, n) of its positions.

    Attributes:
        position: joint position [rad], shape (N, n).
    """

    def __init__(self, motion: Motion) -> None:
        self._t = motion.t
        self.position = motion.q

    def shifted(self, series: np.ndarray, time: np.ndarray) -> np.ndarray:
        """The series at t + T, T per joint [s], shape (n,); constant beyond the ends."""
        t, out = self._t, np.array(series)
        for joint in np.flatnonzero(time):
            spline = make_interp_spline(t, series[:, joint], k=3)
            out[:, joint] = spline(np.clip(t + time[joint], t[0], t[-1]))
        return out

    def rate(self, series: np.ndarray) -> np.ndarray:
        """The derivative of a series by time, by a cubic spline [1/s]."""
        return make_interp_spline(self._t, series, k=3)(self._t, 1)

    def lagged(self, series: np.ndarray, time_constant: np.ndarray) -> np.ndarray:
        """The series behind 1 / (1 + T s), T per joint [s], exact for a piecewise linear one; at rest before it."""
        dt, out = float(self._t[1] - self._t[0]), np.array(series)
        for joint in np.flatnonzero(time_constant):
            time, u = float(time_constant[joint]), series[:, joint]
            keep = np.exp(-dt / time)
            mean = (1.0 - keep) * time / dt
            newer, older = 1.0 - mean, mean - keep
            out[:, joint] = lfilter(
                [newer, older], [1.0, -keep], u, zi=[u[0] * (1.0 - newer)]
            )[0]
        return out
