"""The way from the commanded torque to the joint: delay, scale, offset."""

from __future__ import annotations

import numpy as np


class TorquePath:
    """applied(t) = (1 + s) recorded(t - T) + offset, step by step.

    The commanded torque is held over each step, so that a delayed one changes at most once within a step, after the
    fraction of T / dt. Its mean over the step, (1 - fraction) u[k - whole] + fraction u[k - whole - 1], is applied: the
    impulse of each step is exact for every T, the moment within the step is not. Before the first command that command
    counts as having been held.
    """

    def __init__(self, delay: np.ndarray, scale: np.ndarray, offset: np.ndarray, dt: float) -> None:
        """Set up for delay T [s], scale s [1] and offset [N m], each of shape (n,), and steps of dt [s]."""
        steps = np.asarray(delay) / dt
        self._whole = np.floor(steps + 1e-9).astype(int)
        self._fraction = np.clip(steps - self._whole, 0.0, 1.0)
        self._gain, self._offset = 1.0 + scale, offset
        self._columns = np.arange(len(steps))
        self._length = int(self._whole.max()) + 2
        self._held = np.zeros((self._length, len(steps)))
        self.reset()

    def reset(self) -> None:
        """Forget all commands."""
        self._now = -1

    def __call__(self, recorded: np.ndarray) -> np.ndarray:
        """Torque [N m] that reaches the joints during this step for the torque commanded at its start, shape (n,)."""
        if self._now < 0:
            self._held[:] = recorded
        self._now += 1
        self._held[self._now % self._length] = recorded
        late = self._now - self._whole
        newer, older = (self._held[index % self._length, self._columns] for index in (late, late - 1))
        return self._gain * ((1.0 - self._fraction) * newer + self._fraction * older) + self._offset
