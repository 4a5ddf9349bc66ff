"""The courses of many episodes side by side: references and feedforward at the steps of an action."""

from __future__ import annotations

import numpy as np

from gapscope.envs.episode import Course, Timing


class Courses:
    """Courses of N episodes, K actions of S steps, n joints; each at an action of its own.

    Args:
        timing: of the episodes.
        count: N.
        n_joints: n.
        planned: numbers in the planned part of the observation.
    """

    def __init__(self, timing: Timing, count: int, n_joints: int, planned: int) -> None:
        self._steps, self._last = timing.sub_steps, timing.actions
        length = timing.actions * timing.sub_steps + 1
        self._step_q, self._step_torque = np.zeros((2, count, length, n_joints))
        self._dq = np.zeros((count, timing.actions + 1, n_joints))
        self._planned = np.zeros((count, timing.actions + 1, planned))
        self._arms = np.arange(count)
        self._rows = np.arange(timing.sub_steps + 1)[:, None]

    def put(self, number: int, course: Course) -> None:
        """Give an episode, numbered from 0, another course."""
        length = self._step_q.shape[1]
        self._step_q[number] = course.step_q[:length]
        self._step_torque[number] = course.step_torque[:length]
        self._dq[number] = course.step_dq[: length : self._steps]
        self._planned[number] = course.planned

    def steps(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Reference [rad] and feedforward [N m] at the steps of an action, the next one's first included.

        Args:
            at: number of the action of each episode, shape (N,); beyond the end the course stands still.

        Returns:
            Two arrays of shape (S + 1, N, n).
        """
        rows = np.minimum(at * self._steps + self._rows, self._last * self._steps)
        return self._step_q[self._arms, rows], self._step_torque[self._arms, rows]

    def rate(self, at: np.ndarray) -> np.ndarray:
        """Velocity of the reference when an action is chosen [rad/s], shape (N, n)."""
        return self._dq[self._arms, np.minimum(at, self._last)]

    def position(self, at: np.ndarray) -> np.ndarray:
        """The reference when an action is chosen [rad], shape (N, n)."""
        last = np.minimum(at, self._last) * self._steps
        return self._step_q[self._arms, last]

    def planned(self, at: np.ndarray) -> np.ndarray:
        """The planned part of the observation, shape (N, ...)."""
        return self._planned[self._arms, np.minimum(at, self._last)]
