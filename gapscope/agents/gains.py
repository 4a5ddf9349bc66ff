"""Gains by bandwidth and damping ratio, on the joints' own inertia."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.envs.actions import Gains
from gapscope.envs.arguments import positive


@dataclass(frozen=True)
class Tuning:
    """How stiff a loop is to be.

    Attributes:
        bandwidth: w / 2 pi [Hz].
        damping: zeta [1].

    Raises:
        InputError: a number that is not above zero.
    """

    bandwidth: float = 4.0
    damping: float = 0.7

    def __post_init__(self) -> None:
        """Check the numbers."""
        positive("bandwidth", self.bandwidth, "Hz")
        positive("damping", self.damping, "1")

    @property
    def stiffness(self) -> float:
        """w^2 [1/s^2], gain from position error to acceleration."""
        return (2 * np.pi * self.bandwidth) ** 2

    @property
    def rate(self) -> float:
        """2 zeta w [1/s], gain from velocity error to acceleration."""
        return 2 * self.damping * 2 * np.pi * self.bandwidth

    def times(self, factor: float) -> Tuning:
        """The same with the bandwidth multiplied: kp grows with the square of the factor, kd with the factor."""
        return Tuning(self.bandwidth * factor, self.damping)


def own_inertia(arm: NominalArm, posture: np.ndarray) -> np.ndarray:
    """M_ii + I_i [kg m^2], shape (n,), of the nominal arm at a posture [rad], shape (n,)."""
    return np.diag(RigidBody(arm).mass_matrix(posture)) + arm.armature


def gains(inertia: np.ndarray, tuning: Tuning) -> Gains:
    """kp = w^2 M [N m/rad] and kd = 2 zeta w M [N m s/rad], each (n,), on inertias M [kg m^2], shape (n,)."""
    return Gains(tuning.stiffness * inertia, tuning.rate * inertia)
