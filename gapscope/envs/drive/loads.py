"""What acts on the links besides gravity and the drive: laws of torque without rest or play, forces from outside."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import (
    Drift,
    DryLaw,
    External,
    LinkChange,
    Path,
    Sensing,
    Signals,
    TorqueLaw,
)
from gapscope.envs.drive.rows import Laws

OF_ONE_MOMENT = (TorqueLaw, Drift, LinkChange, Path, Sensing, External)
"""Kinds of effects whose laws the simulator calls, knowing the present state alone."""


def check_simulated(effects: tuple[AppliedEffect, ...]) -> None:
    """Check that the simulator has a step for every effect.

    Raises:
        InputError: an effect whose parameters are not quantities of the drives, and that has no law of one moment.
    """
    for applied in effects:
        effect = applied.effect
        known = effect.quantities.keys() >= set(effect.names)
        in_time = isinstance(effect, Path) and effect.varies_with == "time"
        if not known and (in_time or not isinstance(effect, OF_ONE_MOMENT)):
            raise InputError(
                "the simulator has no step for this effect",
                "leave it out, or add its step to gapscope/envs/drive",
                where=applied.name,
            )


class Loads:
    """Torque on the links [N m], J^T f less what the smooth laws of torque take, joints in kinematic order.

    Dry and viscous friction and coupled motors are solved with the step instead.

    Args:
        arm: an arm with effects.
        body: its nominal rigid bodies, at whose last link's centre of mass a force acts.

    Attributes:
        present: whether there are any.
        stiffness: of the springs [N m/rad], shape (n,).
    """

    def __init__(self, arm: CorrectedArm, body: RigidBody) -> None:
        order = body.order
        self._body, self._arm = body, arm
        self.stiffness = arm.quantity("stiffness")[order]
        down = arm.base_rotation().T
        self._forces = []
        for applied in arm.effects:
            if isinstance(applied.effect, External):
                force, start, end = applied.parameters.values()
                self._forces.append((applied.effect, down @ force, start, end))
        self._laws = Laws(
            [item for item in arm.of_kind(TorqueLaw) if not _solved(item[0])], order
        )
        # what is friction drifts with it
        self._drifting = bool(arm.of_kind(Drift)) and any(
            law.family == "friction" for law, _ in self._laws.acting
        )
        self.present = bool(self._forces or self._laws.acting)

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
        signals = Signals(t, q, dq, load)
        for law, values in self._laws.acting:
            torque = law.law(signals, *values)
            if self._drifting and law.family == "friction":
                torque = torque * self._arm.drift(np.array([t]))[0, self._body.order]
            out -= torque
        for effect, force, start, end in self._forces:
            if effect.active(t, start, end):
                out += self._body.force_torque(q[self._body.places], force)[0][
                    self._body.order
                ]
        return out


def _solved(law: TorqueLaw) -> bool:
    """Whether a law of torque is solved with the step, since it is stiff at rest or acts on several joints."""
    viscous = "damping" in law.quantities.values()
    return isinstance(law, DryLaw) or viscous or law.reach == "motor"
