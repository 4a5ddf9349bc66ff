"""The torque that an arm predicts on a motion, kept with that of its bodies, which most changes of the arm leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Path


@dataclass(frozen=True)
class Prediction:
    """Torque that an arm predicts would be recorded on a motion of N samples, limits aside.

    Attributes:
        arm: the arm, without limits.
        body: dynamics of its nominal bodies, with the load that the recording names.
        motion: the recorded motion.
        rigid: torque of the bodies [N m], (N, n).
        torque: that would be recorded [N m], (N, n).
    """

    arm: CorrectedArm
    body: RigidBody
    motion: Motion
    rigid: np.ndarray
    torque: np.ndarray

    @classmethod
    def of(cls, corrected: CorrectedArm, body: RigidBody, motion: Motion) -> Prediction:
        """The prediction of an arm."""
        arm = corrected.unlimited
        rigid = arm.rigid_torque(body, motion)
        return cls(arm, body, motion, rigid, _recorded(arm, rigid, motion))

    def by(self, arm: CorrectedArm) -> np.ndarray:
        """Torque that an arm predicts whose bodies move as this one's [N m], (N, n)."""
        return _recorded(arm, self.rigid, self.motion)

    def changes(self, arms: Sequence[CorrectedArm]) -> np.ndarray:
        """By how much K arms whose bodies move as this one's predict another torque [N m], (N, K, n)."""
        own = _path(self.arm)
        alike = np.array([_path(arm) == own for arm in arms], dtype=bool)
        out = np.empty((len(self.rigid), len(arms), self.rigid.shape[1]))
        for k in np.flatnonzero(~alike):
            out[:, k] = self.by(arms[k])
        # the way from the recorded torque to the joint is undone for all at once
        needed = [
            arms[k].needed_torque(self.rigid, self.motion)
            for k in np.flatnonzero(alike)
        ]
        if needed:
            stacked = np.stack(needed, axis=1)
            out[:, alike] = self.arm.recorded_torque(stacked, self.motion)
        out -= self.torque[:, None]
        return out


def _path(arm: CorrectedArm) -> list[int]:
    """Which effects lie between the recorded torque and the joint."""
    return [id(e) for e in arm.effects if isinstance(e.effect, Path)]


def _recorded(arm: CorrectedArm, rigid: np.ndarray, motion: Motion) -> np.ndarray:
    """Torque that is recorded if the bodies need ``rigid`` [N m], (N, n)."""
    return arm.recorded_torque(arm.needed_torque(rigid, motion), motion)
