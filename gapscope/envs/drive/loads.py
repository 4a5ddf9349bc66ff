"""What acts on the links besides gravity and the drive: springs beside the joints, and a force from outside."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import External, Signals
from gapscope.effects.transmission import spring


class Loads:
    """Torque on the links, J^T f - k (q - q0) [N m], joints in kinematic order.

    Args:
        arm: an arm with effects.
        body: its nominal rigid bodies, at whose last link's centre of mass a force acts.

    Attributes:
        present: whether there are any.
        stiffness: of the springs [N m/rad], shape (n,).
    """

    def __init__(self, arm: CorrectedArm, body: RigidBody) -> None:
        order = body.order
        self._body = body
        self.stiffness, self._rest = (
            arm.value("parallel_spring", name)[order] for name in ("stiffness", "rest")
        )
        self._springs = bool(self.stiffness.any())
        down = arm.base_rotation().T
        self._forces = [
            (
                applied.effect,
                down @ applied.parameters["force"],
                *(float(applied.parameters[x]) for x in ("start", "end")),
            )
            for applied in arm.effects
            if isinstance(applied.effect, External)
        ]
        self.present = self._springs or bool(self._forces)

    def __call__(self, t: float, q: np.ndarray) -> np.ndarray:
        """Torque [N m] at time t [s] and positions q [rad], shape (n,)."""
        out = np.zeros_like(q)
        if self._springs:
            out -= spring(Signals(t, q, q, q), self.stiffness, self._rest)
        for effect, force, start, end in self._forces:
            if effect.active(t, start, end):
                out += self._body.force_torque(q[self._body.places], force)[0][
                    self._body.order
                ]
        return out
