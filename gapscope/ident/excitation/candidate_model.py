"""Model that scores a candidate: the base columns of its regressor and its torque, with exact derivatives."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.feedforward import feedforward
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.ident.model.base_parameters import random_states, structural_base
from gapscope.ident.model.regressor import Regressor

SAMPLES = 400
"""Random samples from which the base columns are found."""
SHIFTS = np.array([1.0, 3.0, 5.0, 7.0]) * np.pi / 4
"""Shifts from which the derivative of a trigonometric polynomial of degree two is exact [rad]."""
WEIGHTS = np.array([1.0, -1.0, 1.0, -1.0]) / (8 * np.sin(SHIFTS / 2) ** 2)
"""Their weights."""


class ExcitationModel:
    """Base regressor W(q, dq, ddq) and nominal torque of an arm.

    The inertial columns are linear in ddq, quadratic in dq and, as rotations enter each of them twice, trigonometric
    polynomials of degree two in the position of every joint that turns. Their derivatives therefore follow without
    error from a few shifted evaluations: by ddq from one step, by dq from two, by q from four [wierichs2022]. The
    sign of the velocity in the column of Coulomb friction counts as constant.

    Args:
        arm: the nominal arm.
        quantities: with columns of their own, as in ``Regressor``.

    Attributes:
        names: of the base columns, shape (b,).
        reference: RMS of each base column over random states within the limits, shape (b,).
    """

    def __init__(
        self, arm: NominalArm, body: RigidBody, quantities: tuple[str, ...] = ()
    ) -> None:
        self.arm, self.body = arm, body
        self._regressor = Regressor(arm, body, quantities)
        base = structural_base(self._regressor, np.random.default_rng(0), SAMPLES)
        self._kept = base.kept
        self.names = tuple(self._regressor.names[i] for i in self._kept)
        states = random_states(self._regressor, np.random.default_rng(0), SAMPLES)
        # typical size of each column, whatever the motion
        mean_square = (self.matrix(states) ** 2).mean(axis=(0, 1))
        self.reference = np.sqrt(mean_square)

    def matrix(self, motion: Motion) -> np.ndarray:
        """W of a motion of N samples, shape (N, n, b)."""
        return self._regressor.matrix(motion)[:, :, self._kept]

    def torque(self, motion: Motion) -> np.ndarray:
        """Nominal torque with armature and data sheet friction [N m], shape (N, n)."""
        return feedforward(
            self.arm, self.body, "nominal", motion.q, motion.dq, motion.ddq
        )

    def pullback(
        self, motion: Motion, by_matrix: np.ndarray, by_torque: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gradients by q, dq and ddq, each (N, n), of a function whose gradients by W and torque are given.

        Args:
            motion: N samples.
            by_matrix: gradient by W, shape (N, n, b).
            by_torque: gradient by the nominal torque, shape (N, n).
        """
        n, links = self.arm.n_joints, 10 * self.arm.n_joints
        full = np.zeros((len(motion.t), n, len(self._regressor.names)))
        full[:, :, self._kept] = by_matrix
        # the nominal torque is the regressor times the nominal parameters
        by_nominal = by_torque[:, :, None] * self.body.inertial_parameters()
        by_q, by_dq, by_ddq = self._inertial(motion, full[:, :, :links] + by_nominal)
        by_ddq += self.arm.armature * by_torque
        by_dq += self.arm.viscous * by_torque
        for k, name in enumerate(self._regressor.quantities):
            first = links + k * n
            own = np.einsum("ijj->ij", full[:, :, first : first + n])
            if name == "rotor":
                by_ddq += own
            elif name == "damping":
                by_dq += own
        return by_q, by_dq, by_ddq

    def _inertial(
        self, motion: Motion, weight: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of sum(weight * Y) by q, dq and ddq, each (N, n); Y and weight have shape (N, n, 10 n)."""
        q, dq, ddq = motion.q, motion.dq, motion.ddq

        def contracted(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
            return np.einsum("tij,tij->t", weight, self.body.regressor(q, dq, ddq))

        here = contracted(q, dq, ddq)
        by_q, by_dq, by_ddq = (np.zeros_like(q) for _ in range(3))
        for j, unit in enumerate(np.eye(q.shape[1])):
            # exact: trigonometric in q, quadratic in dq, linear in ddq
            shifted = [contracted(q + shift * unit, dq, ddq) for shift in SHIFTS]
            by_q[:, j] = WEIGHTS @ np.array(shifted)
            faster, slower = (
                contracted(q, dq + unit, ddq),
                contracted(q, dq - unit, ddq),
            )
            by_dq[:, j] = (faster - slower) / 2
            by_ddq[:, j] = contracted(q, dq, ddq + unit) - here
        return by_q, by_dq, by_ddq
