"""The way from the commanded torque to the joint: what effects on it do to a torque, step by step."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Path
from gapscope.envs.drive.rows import Laws, Rows, repeated


class Moment(NamedTuple):
    """What a law on the way to the joint may ask for of its ``Series`` if it does not depend on time.

    Attributes:
        position: of the motors [rad], shape (n,).
    """

    position: np.ndarray | None


class TorquePath(Rows):
    """What is applied: the command after the laws before delay and lag, these two, and the laws behind them.

    The commanded torque is held over each step, so that a delayed one changes at most once within a step, after the
    fraction of T / dt. What is applied is the mean over the step of what comes out of delay and lag: the impulse of
    each step is exact for every T, the moment within the step is not. The lag's state is exact as well: it decays
    towards the older torque before the change and towards the newer one after it. Before the first command that command
    counts as having been held. A law between delay and lag acts behind both.

    Args:
        arm: an arm with effects.
        order: the arm's joints in the order of the result.
        dt: time step [s].

    Attributes:
        constant: whether a held command always gives the same torque.
        changing: mask of the joints of arms in which it does not, shape (n,).
    """

    ROWS = (
        *("_before", "_after", "_whole", "_fraction", "_lag", "_lagging"),
        *("changing", "_fresh"),
    )

    def __init__(self, arm: CorrectedArm, order: np.ndarray, dt: float) -> None:
        laws = arm.of_kind(Path)
        in_time = [law.place for law, _ in laws if law.varies_with == "time"]
        first = min(in_time, default=0)
        now = [item for item in laws if item[0].varies_with != "time"]
        self._before = Laws([item for item in now if item[0].place < first], order)
        self._after = Laws([item for item in now if item[0].place >= first], order)
        delay, lag = (arm.quantity(name)[order] for name in ("delay", "lag"))
        steps = delay / dt
        self._whole = np.floor(steps + 1e-9).astype(int)
        self._fraction = np.clip(steps - self._whole, 0.0, 1.0)
        self._lag = _Lag(lag, self._fraction, dt)
        # a lag on one joint of an arm takes all its joints through the same formula
        self._lagging = np.full(len(steps), bool(lag.any()))
        acting = self._before.acting + self._after.acting
        changes = lag.any() or delay.any()
        changes |= any(law.varies_with == "position" for law, _ in acting)
        self.changing = np.full(len(steps), bool(changes))
        self._fresh = np.ones(len(steps), dtype=bool)
        self._held, self._now = np.zeros((2, len(steps))), -1
        self.note()
        self.reset()

    def note(self) -> None:
        """Note what does nothing and is left out of a step, and hold as many commands as the longest delay needs."""
        size = len(self._whole)
        self._columns = np.arange(size)
        self._first, self._last = (
            repeated(partial(_through, laws), 2, size) if laws.acting else None
            for laws in (self._before, self._after)
        )
        self._lags = bool(self._lagging.any())
        self._in_time = bool(self._lags or self._whole.any() or self._fraction.any())
        self.constant = not self.changing.any()
        length = int(self._whole.max()) + 2
        if self._held.shape != (length, size):
            self._held, self._now = np.zeros((length, size)), -1

    def beside(self, count: int) -> TorquePath:
        """The same for ``count`` such arms; all commands are forgotten."""
        many = super().beside(count)
        many._held = np.zeros_like(many._held)
        many.reset()
        return many

    def put(self, number: int, one: TorquePath) -> None:
        """Take over the way of one arm as that of arm ``number``, whose commands are forgotten."""
        before, now, length = self._held, self._now, len(self._held)
        super().put(number, one)
        size = len(one._whole)
        self.reset(slice(number * size, (number + 1) * size))
        if len(self._held) != length:
            # the commands of the other arms, in a ring of another length
            self._now = now
            for ago in range(min(length, len(self._held), now + 1)):
                row = before[(now - ago) % length]
                self._held[(now - ago) % len(self._held)] = row

    def reset(self, rows: slice = slice(None)) -> None:
        """Forget all commands, of all joints or of some."""
        self._fresh[rows] = True
        self._starts = True

    def __call__(
        self, commanded: np.ndarray, position: np.ndarray | None = None
    ) -> np.ndarray:
        """Torque [N m] that reaches the joints during this step for the torque commanded at its start, shape (n,).

        It is the commanded torque itself if nothing changes it.

        Args:
            commanded: [N m], shape (n,).
            position: of the motors [rad], shape (n,); not needed if the path is ``constant``.
        """
        u = commanded
        if self._first:
            u = self._first(u, position)
        if self._in_time:
            u = self._through_time(u)
        if self._last:
            u = self._last(u, position)
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


def _through(
    laws: Laws[Path], torque: np.ndarray, position: np.ndarray | None
) -> np.ndarray:
    """Torque [N m] that leaves some laws one after the other."""
    moment = Moment(position)
    for law, values in laws.acting:
        torque = law.applied(torque, moment, *values)
    return torque


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
