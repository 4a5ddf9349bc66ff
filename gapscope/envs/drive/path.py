"""The way from the commanded torque to the joint: saturation, delay, lag, scale, offset, ripple."""

from __future__ import annotations

import numpy as np

from gapscope.effects.actuation import ripple_torque, saturate
from gapscope.effects.corrected import CorrectedArm


class TorquePath:
    """applied = (1 + s) u + offset + A sin(n q + phi), with u the command clipped, delayed and lagged, step by step.

    The commanded torque is held over each step, so that a delayed one changes at most once within a step, after the
    fraction of T / dt. What is applied is the mean over the step of what comes out of delay and lag: the impulse of
    each step is exact for every T, the moment within the step is not. The lag's state is exact as well: it decays
    towards the older torque before the change and towards the newer one after it. Before the first command that command
    counts as having been held.

    Args:
        delay, scale, offset: T [s], s [1] and offset [N m], each of shape (n,).
        dt: time step [s].
        lag: time constant [s], shape (n,); none by default.
        limit: of the commanded torque [N m], shape (n,), 0 for none; none by default.
        ripple: A [N m], n [1], phi [rad], each of shape (n,); none by default.

    Attributes:
        constant: whether a held command always gives the same torque.
    """

    def __init__(
        self,
        delay: np.ndarray,
        scale: np.ndarray,
        offset: np.ndarray,
        dt: float,
        lag: np.ndarray | None = None,
        limit: np.ndarray | None = None,
        ripple: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None,
    ) -> None:
        steps = np.asarray(delay) / dt
        self._late = bool(np.any(delay))
        self._whole = np.floor(steps + 1e-9).astype(int)
        self._fraction = np.clip(steps - self._whole, 0.0, 1.0)
        # a ring of the commands held in the last steps, as many as the longest delay needs
        self._length = int(self._whole.max()) + 2
        self._held = np.zeros((self._length, len(steps)))
        self._columns = np.arange(len(steps))
        self._gain, self._offset = 1.0 + scale, offset
        self._changes = bool(np.any(scale) or np.any(offset))
        # what does nothing is left out of the step
        self._limit = limit if limit is not None and np.any(limit) else None
        self._ripple = ripple if ripple is not None and np.any(ripple[0]) else None
        self._lag: _Lag | None = None
        if lag is not None and np.any(lag):
            self._lag = _Lag(lag, self._fraction, dt)
        self.constant = not self._late and self._lag is None and self._ripple is None
        self.reset()

    @classmethod
    def of(cls, arm: CorrectedArm, order: np.ndarray, dt: float) -> TorquePath:
        """The way to the joints of an arm with effects; ``order`` puts its joints in that of the result."""

        def value(name: str, parameter: str) -> np.ndarray:
            return arm.value(name, parameter)[order]

        a, n, phi = (
            value("torque_ripple", name) for name in ("amplitude", "cycles", "phase")
        )
        return cls(
            value("actuator_delay", "delay"),
            value("torque_scale", "scale"),
            value("torque_offset", "torque"),
            dt,
            lag=value("actuator_lag", "time_constant"),
            limit=value("torque_saturation", "limit"),
            ripple=(a, n, phi),
        )

    def reset(self) -> None:
        """Forget all commands."""
        self._now = -1

    def __call__(
        self, commanded: np.ndarray, position: np.ndarray | None = None
    ) -> np.ndarray:
        """Torque [N m] that reaches the joints during this step for the torque commanded at its start, shape (n,).

        Args:
            commanded: [N m], shape (n,).
            position: of the motors [rad], shape (n,); needed for ripple only.
        """
        u = commanded if self._limit is None else saturate(commanded, None, self._limit)
        if self._late or self._lag is not None:
            u = self._through_time(u)
        u = self._gain * u + self._offset if self._changes else np.array(u)
        if self._ripple is not None and position is not None:
            u += ripple_torque(position, *self._ripple)
        return u

    def _through_time(self, u: np.ndarray) -> np.ndarray:
        """Delay and lag."""
        if self._now < 0:
            self._held[:] = u
            if self._lag is not None:
                self._lag.reset(u)
        self._now += 1
        self._held[self._now % self._length] = u
        late = self._now - self._whole
        newer, older = (
            self._held[index % self._length, self._columns]
            for index in (late, late - 1)
        )
        if self._lag is not None:
            return self._lag(older, newer)
        return (1.0 - self._fraction) * newer + self._fraction * older


class _Lag:
    """Exact 1 / (1 + T s) of a torque that changes once within each step, after ``fraction`` of it."""

    def __init__(
        self, time_constant: np.ndarray, fraction: np.ndarray, dt: float
    ) -> None:
        # without a lag T is so small that the state follows at once, and no division by 0 occurs
        rate = dt / np.maximum(time_constant, 1e-9 * dt)
        self._before = np.exp(-rate * fraction)
        self._after = np.exp(-rate * (1.0 - fraction))
        self._span_before = (1.0 - self._before) / rate
        self._span_after = (1.0 - self._after) / rate
        self._fraction = fraction
        self._state = np.zeros_like(time_constant)

    def reset(self, torque: np.ndarray) -> None:
        """At rest under a torque [N m]."""
        self._state = np.array(torque, dtype=float)

    def __call__(self, older: np.ndarray, newer: np.ndarray) -> np.ndarray:
        """Mean over the step [N m]; the state moves on to its end."""
        start = self._state
        middle = older + (start - older) * self._before
        self._state = newer + (middle - newer) * self._after
        mean = older * self._fraction + (start - older) * self._span_before
        mean = mean + newer * (1.0 - self._fraction)
        return mean + (middle - newer) * self._span_after
