"""What a track is measured by: errors of joints and tool, reward, and how smooth the torque is."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from gapscope.agents.tracking import TrackingRun
from gapscope.arm.dynamics.kinematics import Kinematics
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.named_motions import Workspace
from gapscope.arm.nominal import NominalArm
from gapscope.envs.actions import rated_torque, torque_limit
from gapscope.envs.reward import Reward

ACTION = 0.02
"""Period of the environment's actions, for the reward and the tool's error [s]."""


@dataclass(frozen=True)
class Measures:
    """Measures of one track.

    Attributes:
        joint_error: RMS of q_ref - q of the encoders over time and joints [rad]; infinite if the arm diverged.
        tool_error: RMS distance of the tool between both, by the kinematics [m]; infinite if the arm diverged.
        reward: mean per action of the environment's reward, an action being the torque over the rated torque; what is
            missing because the arm diverged counts as 0 [1].
        torque_rate: RMS over time and joints of the change of the commanded torque per tick [N m/s].
        diverged: whether the arm diverged.
    """

    joint_error: float
    tool_error: float
    reward: float
    torque_rate: float
    diverged: bool


class TrackingMetrics:
    """Measures the tracks of one arm.

    Args:
        arm: the nominal arm.
        body: its rigid-body model.
        space: where it moves.
        reward: tolerance and weights; by default the environment's.
    """

    def __init__(
        self,
        arm: NominalArm,
        body: RigidBody,
        space: Workspace,
        reward: Reward | None = None,
    ) -> None:
        self.limit = torque_limit(arm, body)
        self._rated = rated_torque(arm, body, space)
        self._kinematics: Kinematics = space.kinematics
        self._reward = reward or Reward()

    def __call__(self, track: TrackingRun, dt: float, duration: float) -> Measures:
        """Measure a track with a period of ``dt`` [s] on a course of ``duration`` [s]."""
        every = max(1, round(ACTION / dt))
        actions = max(1, round(duration / dt) // every)
        reward = self._reward_per_action(track, every, actions)
        if track.diverged:
            return Measures(inf, inf, reward, inf, True)
        return Measures(
            joint_error=_rms(track.q_ref - track.q),
            tool_error=self._tool_error(track, every),
            reward=reward,
            torque_rate=_rms(np.diff(track.tau, axis=0) / dt),
            diverged=False,
        )

    def _tool_error(self, track: TrackingRun, every: int) -> float:
        """RMS distance of the tool between reference and encoders, once per action [m]."""
        tool = self._kinematics.tool
        wanted = [tool(q).position for q in track.q_ref[::every]]
        reached = [tool(q).position for q in track.q[::every]]
        squares = np.square(np.array(wanted) - np.array(reached)).sum(axis=1)
        return float(np.sqrt(np.mean(squares)))

    def _reward_per_action(self, track: TrackingRun, every: int, actions: int) -> float:
        """Mean reward of the actions, those that were not done included."""
        effort = track.tau / self._rated
        last = min(len(track.t), actions * every + 1)
        total = 0.0
        for i in range(every, last, every):
            error = track.q_ref[i] - track.q[i]
            load = float(np.mean(effort[i - every : i] ** 2))
            before = max(i - 1 - every, 0)
            jump = effort[i - 1] - effort[before]
            total += float(self._reward(error, load, jump).total)
        return total / actions


def _rms(x: np.ndarray) -> float:
    """Root mean square over all numbers."""
    return float(np.sqrt(np.mean(x**2)))
