"""What acts on the links besides gravity and the drive: springs beside the joints, forces from outside, other laws."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import SHIPPED
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import External, LinkChange, Signals, TorqueLaw
from gapscope.effects.transmission import spring


def check_simulated(effects: tuple[AppliedEffect, ...]) -> None:
    """Check that the simulator has a step for every effect.

    Raises:
        InputError: an effect that a user entered is neither a smooth torque law nor a change of a link.
    """
    for applied in effects:
        # dry friction taken at the present velocity would chatter about standstill
        steps = type(applied.effect) in (TorqueLaw, LinkChange)
        if applied.name not in SHIPPED and not steps:
            raise InputError(
                "the simulator has no step for this effect",
                "leave it out, or add its step to gapscope/envs/drive",
                where=applied.name,
            )


class Loads:
    """Torque on the links, J^T f - k (q - q0) [N m], joints in kinematic order, less that of laws entered by a user.

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
        self._laws = [
            (law.law, [value[order] for value in values])
            for law, values in arm.of_kind(TorqueLaw)
            if law.name not in SHIPPED
        ]
        self.present = self._springs or bool(self._forces) or bool(self._laws)

    def __call__(
        self, t: float, q: np.ndarray, dq: np.ndarray, load: np.ndarray
    ) -> np.ndarray:
        """Torque [N m], shape (n,).

        Args:
            t: time [s].
            q, dq: positions [rad] and velocities [rad/s], shape (n,).
            load: torque through the transmission [N m], shape (n,).
        """
        out = np.zeros_like(q)
        if self._springs:
            out -= spring(Signals(t, q, q, q), self.stiffness, self._rest)
        for law, values in self._laws:
            out -= law(Signals(t, q, dq, load), *values)
        for effect, force, start, end in self._forces:
            if effect.active(t, start, end):
                out += self._body.force_torque(q[self._body.places], force)[0][
                    self._body.order
                ]
        return out
