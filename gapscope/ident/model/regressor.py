"""The identification regressor, tau = Y(q, dq, ddq) pi: inertial columns, and columns derived from effects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gapscope.arm.dynamics.rigid_body import INERTIAL_PARAMETERS, RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.joint_units import joint_unit
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm

JOINT_COLUMNS = ("armature", "viscous_friction", "coulomb_friction", "torque_offset")
"""Effects that are linear in one parameter per joint, and so have a column per joint."""


class Regressor:
    """Y with tau = Y pi for an arm of n joints; pi stacks the links' inertial parameters and those of effects.

    Inertial columns come first, ten per link in joint order and in the order of
    ``gapscope.arm.dynamics.rigid_body.INERTIAL_PARAMETERS`` (kg, kg m, kg m^2, in the frame of the joint that moves
    the link); then, effect by effect, one column per joint: the torque that the effect adds when its parameter is 1.

    Args:
        arm: the nominal arm.
        body: its rigid-body dynamics; built if ``None``.
        effects: names of effects with a column per joint, among ``JOINT_COLUMNS``.

    Attributes:
        names: of the columns, ``m1``, ``mx1``, ... and the effects' symbols with the joint, ``b1``; shape (p,).
        units: of pi, shape (p,).

    Raises:
        InputError: an effect has no such column.
    """

    def __init__(
        self,
        arm: NominalArm,
        body: RigidBody | None = None,
        effects: Sequence[str] = JOINT_COLUMNS,
    ) -> None:
        for name in effects:
            if name not in JOINT_COLUMNS:
                raise InputError(
                    f"{name} is no effect with a regressor column",
                    f"choose among {', '.join(JOINT_COLUMNS)}",
                    where="effects",
                )
        self.arm = arm
        self.body = body or RigidBody(arm)
        self.effects = tuple(effects)
        # ten columns of each link, then one per joint of each effect
        names, units = [], []
        for joint in range(1, arm.n_joints + 1):
            names += [f"{name}{joint}" for name in INERTIAL_PARAMETERS]
            units += ["kg", *["kg m"] * 3, *["kg m^2"] * 6]
        for name in self.effects:
            parameter = CATALOGUE[name].parameters[0]
            for joint in range(1, arm.n_joints + 1):
                names.append(f"{parameter.symbol}{joint}")
                units.append(joint_unit(parameter.unit, arm.sliding[joint - 1]))
        self.names, self.units = tuple(names), tuple(units)

    def matrix(self, motion: Motion, out: np.ndarray | None = None) -> np.ndarray:
        """Y of a motion of N samples, shape (N, n, p).

        Args:
            motion: the motion.
            out: array that Y is written into, shape (N, n, p), such as one that chunks of a long motion share.
        """
        n, links = self.arm.n_joints, 10 * self.arm.n_joints
        if out is None:
            out = np.empty((len(motion.t), n, len(self.names)))
        # written in place: the columns of a long motion fill the memory once
        self.body.regressor(motion.q, motion.dq, motion.ddq, out[:, :, :links])
        out[:, :, links:] = 0.0
        for k, name in enumerate(self.effects):
            first = links + k * n
            # a view: an effect acts on its own joint alone
            diagonal = np.einsum("ijj->ij", out[:, :, first : first + n])
            diagonal[:] = self._unit_torque(name, motion)
        return out

    @property
    def support(self) -> np.ndarray:
        """Columns that can be other than zero in each joint's rows, boolean, shape (n, p).

        A joint's torque depends on the links that it carries, none of which comes before it in kinematic order, and on
        its own effects.
        """
        n = self.arm.n_joints
        carried = self.body.places[None, :] >= self.body.places[:, None]
        return np.hstack(
            [
                np.repeat(carried, 10, axis=1),
                *[np.eye(n, dtype=bool)] * len(self.effects),
            ]
        )

    def nominal(self) -> np.ndarray:
        """The pi of the nominal arm and its data sheet, shape (p,)."""
        sheet = {
            "armature": self.arm.armature,
            "viscous_friction": self.arm.viscous,
            "coulomb_friction": self.arm.coulomb,
            "torque_offset": np.zeros(self.arm.n_joints),
        }
        return np.concatenate(
            [self.body.inertial_parameters(), *(sheet[name] for name in self.effects)]
        )

    def _unit_torque(self, name: str, motion: Motion) -> np.ndarray:
        """Recorded torque that an effect of value 1 adds to an arm that needs none [N m], shape (N, n)."""
        n, still = self.arm.n_joints, np.zeros_like(motion.q)
        applied = AppliedEffect(
            name, tuple(range(1, n + 1)), {CATALOGUE[name].names[0]: np.ones(n)}
        )
        with_it, without = (
            CorrectedArm(self.arm, effects) for effects in ((applied,), ())
        )
        return np.subtract(
            *(
                a.recorded_torque(a.needed_torque(still, motion), motion)
                for a in (with_it, without)
            )
        )
