"""The identification regressor, tau = Y(q, dq, ddq) pi: inertial columns, and columns of the quantities of drives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gapscope.arm.dynamics.rigid_body import INERTIAL_PARAMETERS, RigidBody
from gapscope.arm.joint_units import joint_unit
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect, drives_with
from gapscope.effects.catalogue import of_quantity
from gapscope.effects.corrected import CorrectedArm

JOINT_COLUMNS = ("rotor", "damping", "friction", "offset")
"""Quantities of a drive in which the torque is linear, and which so have a column per joint; keys of ``QUANTITIES``."""


class Regressor:
    """Y with tau = Y pi for an arm of n joints; pi stacks the links' inertial parameters and quantities of drives.

    Inertial columns come first, ten per link in joint order and in the order of
    ``gapscope.arm.dynamics.rigid_body.INERTIAL_PARAMETERS`` (kg, kg m, kg m^2, in the frame of the joint that moves
    the link); then, quantity by quantity, one column per joint: the torque that the effect of this quantity adds at 1.

    Args:
        arm: the nominal arm.
        body: its rigid-body dynamics; built if ``None``.
        quantities: with a column per joint, among ``JOINT_COLUMNS``.

    Attributes:
        names: of the columns, ``m1``, ``mx1``, ... and the quantities' symbols with the joint, ``b1``; shape (p,).
        units: of pi, shape (p,).
    """

    def __init__(
        self,
        arm: NominalArm,
        body: RigidBody | None = None,
        quantities: Sequence[str] = JOINT_COLUMNS,
    ) -> None:
        self.arm = arm
        self.body = body or RigidBody(arm)
        self.quantities = tuple(quantities)
        # ten columns of each link, then one per joint of each quantity
        names, units = [], []
        for joint in range(1, arm.n_joints + 1):
            names += [f"{name}{joint}" for name in INERTIAL_PARAMETERS]
            units += ["kg", *["kg m"] * 3, *["kg m^2"] * 6]
        for name in self.quantities:
            effect, own = of_quantity(name)
            parameter = effect.parameter(own)
            for joint in range(1, arm.n_joints + 1):
                names.append(f"{parameter.symbol}{joint}")
                units.append(joint_unit(parameter.unit, arm.sliding[joint - 1]))
        self.names, self.units = tuple(names), tuple(units)

    def matrix(self, motion: Motion) -> np.ndarray:
        """Y of a motion of N samples, shape (N, n, p)."""
        n, links = self.arm.n_joints, 10 * self.arm.n_joints
        out = np.zeros((len(motion.t), n, len(self.names)))
        still, joints = np.zeros_like(motion.q), tuple(range(1, n + 1))

        def torque(*effects: AppliedEffect) -> np.ndarray:
            """What is recorded of an arm that needs none but by effects [N m], (N, n)."""
            arm = CorrectedArm(self.arm, effects)
            return arm.recorded_torque(arm.needed_torque(still, motion), motion)

        # written in place: the columns of a long motion fill the memory once
        self.body.regressor(motion.q, motion.dq, motion.ddq, out[:, :, :links])
        for k, name in enumerate(self.quantities):
            first = links + k * n
            # a view: a drive acts on its own joint alone
            diagonal = np.einsum("ijj->ij", out[:, :, first : first + n])
            diagonal[:] = torque(drives_with(joints, **{name: np.ones(n)})) - torque()
        return out

    def nominal(self) -> np.ndarray:
        """The pi of the nominal arm and its data sheet, shape (p,)."""
        # on an arm without effects these are the data sheet's
        drives = (CorrectedArm(self.arm).quantity(name) for name in self.quantities)
        return np.concatenate([self.body.inertial_parameters(), *drives])
