"""Signals that effects see: series at sample times, and how many samples a delay takes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, lfilter, sosfiltfilt

from gapscope.arm.dynamics.rigid_body import ArrayCache
from gapscope.arm.motions.motion import Motion
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.parametrisation import Values

# Series over time, shifted, differentiated and lagged, as the laws on the way to the joint need them.


SLOW_DEFLECTION = 12.0
"""Deflections of a transmission are followed up to this frequency [Hz]; their acceleration has no meaning above it."""
_MOVED = ArrayCache(2**26)
"""Shifted series of a joint: arms that differ in one joint or one effect need those of all others again."""


class MotionSeries:
    """The ``gapscope.effects.effect.Series`` of a motion, for series of shape (N, n), or K of them, (N, K, n).

    Args:
        motion: the motion.
        many: whether series are K at once.

    Attributes:
        position, velocity: of the joints [rad], [rad/s], shape (N, n), or (N, 1, n) for many.
    """

    def __init__(self, motion: Motion, *, many: bool = False) -> None:
        self._t = motion.t
        self.position = motion.q[:, None] if many else motion.q
        self.velocity = motion.dq[:, None] if many else motion.dq

    def shifted(self, series: np.ndarray, time: np.ndarray) -> np.ndarray:
        """The series at t + T, T per joint [s], shape (n,); constant beyond the ends."""
        t = self._t
        out = np.array(series)
        for joint in np.flatnonzero(time):
            column = series[..., joint]
            # beyond the ends it stays as it is there
            moved = np.clip(t + time[joint], t[0], t[-1])
            (out[..., joint],) = _MOVED.get(
                "shifted", (t, column, moved), partial(_at, t, column, moved)
            )
        return out

    def rate(self, series: np.ndarray) -> np.ndarray:
        """The derivative of a series by time, by a cubic spline [1/s]."""
        return make_interp_spline(self._t, series, k=3)(self._t, 1)

    def lagged(self, series: np.ndarray, time_constant: np.ndarray) -> np.ndarray:
        """The series behind 1 / (1 + T s), T per joint [s], exact for a piecewise linear one; at rest before it."""
        return self._behind(series, time_constant, 1.0)

    def warmed(self, series: np.ndarray, time_constant: np.ndarray) -> np.ndarray:
        """The same from zero at the start on."""
        return self._behind(series, time_constant, 0.0)

    def _behind(
        self, series: np.ndarray, time_constant: np.ndarray, begun: float
    ) -> np.ndarray:
        """The series behind its lag, which begins at a share of its first value."""
        dt = float(self._t[1] - self._t[0])
        out = np.array(series)
        # without a time constant a series follows itself at once
        for joint in np.flatnonzero(time_constant):
            u = series[..., joint]
            time = float(time_constant[joint])
            keep = np.exp(-dt / time)
            # y[i] = keep y[i-1] + newer u[i] + older u[i-1], exact for u linear within a step
            mean = (1.0 - keep) * time / dt
            newer = 1.0 - mean
            older = mean - keep
            # state of the filter as if that share of the first value had been there for ever
            at_rest = u[:1] * (begun - newer)
            lagged, _ = lfilter([newer, older], [1.0, -keep], u, axis=0, zi=at_rest)
            out[..., joint] = lagged
        return out


def _at(t: np.ndarray, series: np.ndarray, moved: np.ndarray) -> tuple[np.ndarray]:
    """A series at other times, by a cubic spline."""
    return (make_interp_spline(t, series, k=3)(moved),)


class Moment(NamedTuple):
    """What a law on the way to the joint may ask for of its ``Series`` if it does not depend on time.

    Attributes:
        position, velocity: of the motors [rad], [rad/s], (n,), or of one joint over time, (N,).
    """

    position: np.ndarray | None
    velocity: np.ndarray | None

    def warmed(self, series: np.ndarray, time_constant: np.ndarray) -> float:
        """None: a simulator keeps heat as a state of its own."""
        return 0.0


def slow_with_rates(
    deflection: np.ndarray, motion: Motion
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The part of a deflection [rad], (N, n), below ``SLOW_DEFLECTION``, with two derivatives by time."""
    # a slow log has no such band: below Nyquist's frequency then
    cutoff = min(SLOW_DEFLECTION, 0.4 * motion.rate)
    sos = butter(4, cutoff, output="sos", fs=motion.rate)
    # three of its periods, as far as there are samples
    padding = min(len(motion.t) - 1, int(3 * motion.rate / SLOW_DEFLECTION))
    slow = sosfiltfilt(sos, deflection, axis=0, padlen=padding)
    rate = np.gradient(slow, motion.t, axis=0)
    return slow, rate, np.gradient(rate, motion.t, axis=0)


# Random numbers from which severities are made.


class Drawn(NamedTuple):
    """A value drawn evenly between two ends, in parts of what is large on an arm.

    Attributes:
        low, high: the ends, in the unit of the value, or of what it is a part of.
        of: a field of ``ArmScale`` with a value for each joint; none by default.
        each: whether every joint has a number of its own; otherwise all have the same.
        log: whether the logarithm is drawn evenly.
        signed: whether the value may be negative too, either being as likely.
    """

    low: float
    high: float
    of: str = ""
    each: bool = True
    log: bool = False
    signed: bool = False

    def __call__(
        self, rng: np.random.Generator, scale: ArmScale, joints: np.ndarray
    ) -> np.ndarray:
        """The values of joints, from 0, (m,)."""
        # without a size one number is drawn for all of them
        size = len(joints) if self.each else None
        sign = rng.choice([-1.0, 1.0], size) if self.signed else 1.0
        large = getattr(scale, self.of)[joints] if self.of else 1.0
        if self.log:
            drawn = np.exp(rng.uniform(np.log(self.low), np.log(self.high), size))
        else:
            drawn = rng.uniform(self.low, self.high, size)
        return np.asarray(sign * large * drawn)


def drawn(**values: Drawn) -> Callable[..., Values]:
    """The severity of an effect whose parameters are drawn one after the other."""
    return lambda *of_arm: {name: one(*of_arm) for name, one in values.items()}
