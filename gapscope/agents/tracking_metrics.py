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
        reward = self._rewards(track, every, max(1, round(duration / dt) // every))
        if track.diverged:
            return Measures(inf, inf, reward, inf, True)
        joint = float(np.sqrt(np.mean((track.q_ref - track.q) ** 2)))
        pairs = zip(track.q_ref[::every], track.q[::every], strict=True)
        ways = [
            self._kinematics.tool(a).position - self._kinematics.tool(b).position
            for a, b in pairs
        ]
        tool = float(np.sqrt(np.mean(np.sum(np.square(ways), axis=1))))
        rate = float(np.sqrt(np.mean((np.diff(track.tau, axis=0) / dt) ** 2)))
        return Measures(joint, tool, reward, rate, False)

    def _rewards(self, track: TrackingRun, every: int, actions: int) -> float:
        """Mean reward of the actions, those that were not done included."""
        share = track.tau / self._rated
        total = 0.0
        for i in range(every, min(len(track.t), actions * every + 1), every):
            jump = share[i - 1] - share[max(i - 1 - every, 0)]
            load = float(np.mean(share[i - every : i] ** 2))
            total += self._reward(track.q_ref[i] - track.q[i], load, jump).total
        return total / actions
