"""The way from the commanded torque to the joint: saturation, delay, lag, scale, offset, ripple."""

from __future__ import annotations

import numpy as np

from gapscope.effects.actuation import ripple_torque, saturate
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.drive.rows import Rows


class TorquePath(Rows):
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
        changing: mask of the joints of arms in which it does not, shape (n,).
    """

    ROWS = (
        *("_whole", "_fraction", "_gain", "_offset", "_limit", "changing", "_lagging"),
        *("_amplitude", "_cycles", "_phase", "_fresh"),
    )

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
        none = np.zeros(len(steps))
        self._whole = np.floor(steps + 1e-9).astype(int)
        self._fraction = np.clip(steps - self._whole, 0.0, 1.0)
        self._gain, self._offset = 1.0 + scale, np.array(offset, dtype=float)
        self._limit = none if limit is None else limit
        amplitude, cycles, phase = ripple or (none, none, none)
        self._amplitude, self._cycles, self._phase = amplitude, cycles, phase
        time_constant = none if lag is None else lag
        self._lag = _Lag(time_constant, self._fraction, dt)
        # a lag on one joint of an arm takes all its joints through the same formula
        self._lagging = np.full(len(steps), bool(np.any(time_constant)))
        changes = self._lagging.any() or np.any(delay) or np.any(self._amplitude)
        self.changing = np.full(len(steps), bool(changes))
        self._fresh = np.ones(len(steps), dtype=bool)
        self._held = np.zeros((2, len(steps)))
        self._note()
        self.reset()

    def _note(self) -> None:
        """Note what does nothing and is left out of a step, and hold as many commands as the longest delay needs."""
        self._columns = np.arange(len(self._whole))
        self._late = bool(self._whole.any() or self._fraction.any())
        self._lags = bool(self._lagging.any())
        self._scales = bool(np.any(self._gain != 1.0) or self._offset.any())
        self._limits = bool(self._limit.any())
        self._ripples = bool(self._amplitude.any())
        self.constant = not self.changing.any()
        length = int(self._whole.max()) + 2
        if self._held.shape != (length, len(self._whole)):
            self._held, self._now = np.zeros((length, len(self._whole))), -1

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

    def beside(self, count: int) -> TorquePath:
        """The same for ``count`` such arms; all commands are forgotten."""
        many = super().beside(count)
        many._lag = self._lag.beside(count)
        many._held = np.zeros((len(self._held), len(many._whole)))
        many._note()
        many.reset()
        return many

    def put(self, number: int, one: TorquePath) -> None:
        """Take over the way of one arm as that of arm ``number``, whose commands are forgotten."""
        before, now, length = self._held, self._now, len(self._held)
        super().put(number, one)
        self._lag.put(number, one._lag)
        size = len(one._whole)
        self._fresh[number * size : (number + 1) * size] = True
        self._starts = True
        self._note()
        if len(self._held) != length:
            # the commands of the other arms, in a ring of another length
            self._now = now
            for ago in range(min(length, len(self._held), now + 1)):
                row = before[(now - ago) % length]
                self._held[(now - ago) % len(self._held)] = row

    def reset(self) -> None:
        """Forget all commands."""
        self._now = -1
        self._fresh[:] = True
        self._starts = True

    def __call__(
        self, commanded: np.ndarray, position: np.ndarray | None = None
    ) -> np.ndarray:
        """Torque [N m] that reaches the joints during this step for the torque commanded at its start, shape (n,).

        Args:
            commanded: [N m], shape (n,).
            position: of the motors [rad], shape (n,); needed for ripple only.
        """
        u = saturate(commanded, None, self._limit) if self._limits else commanded
        if self._late or self._lags:
            u = self._through_time(u)
        u = self._gain * u + self._offset if self._scales else np.array(u)
        if self._ripples and position is not None:
            u += ripple_torque(position, self._amplitude, self._cycles, self._phase)
        return u

    def _through_time(self, u: np.ndarray) -> np.ndarray:
        """Delay and lag."""
        if self._starts:
            np.copyto(self._held, u, where=self._fresh)
            self._lag.start(u, self._fresh)
            self._fresh[:] = False
            self._starts = False
        self._now += 1
        length = len(self._held)
        self._held[self._now % length] = u
        late = self._now - self._whole
        newer, older = (
            self._held[index % length, self._columns] for index in (late, late - 1)
        )
        late_only = (1.0 - self._fraction) * newer + self._fraction * older
        if not self._lags:
            return late_only
        return np.where(self._lagging, self._lag(older, newer), late_only)


class _Lag(Rows):
    """Exact 1 / (1 + T s) of a torque that changes once within each step, after ``fraction`` of it."""

    ROWS = (
        *("_before", "_after", "_span_before", "_span_after", "_fraction", "_state"),
    )

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

    def start(self, torque: np.ndarray, fresh: np.ndarray) -> None:
        """The joints of a mask are at rest under a torque [N m]."""
        self._state = np.where(fresh, torque, self._state)

    def __call__(self, older: np.ndarray, newer: np.ndarray) -> np.ndarray:
        """Mean over the step [N m]; the state moves on to its end."""
        start = self._state
        middle = older + (start - older) * self._before
        self._state = newer + (middle - newer) * self._after
        mean = older * self._fraction + (start - older) * self._span_before
        mean = mean + newer * (1.0 - self._fraction)
        return mean + (middle - newer) * self._span_after
