"""A cascade: the position's error sets a velocity, whose PI controller gives the torque."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gapscope.arm.control.integrator import Integrator
from gapscope.arm.controller import Controller, Gain


@dataclass(frozen=True, kw_only=True)
class Cascade(Controller):
    """tau = feedforward + kv (w - dq) + z, dz/dt = ki (w - dq), w = kp (q_ref - q) + dq_ref.

    Without ki it is PD with the gains kv kp and kv.

    Attributes:
        kp: of the outer loop [1/s], shape (n,).
        kv, ki: of the inner loop [N m s/rad], [N m/rad], shape (n,).
        integrator: bounds of z.
    """

    kind = "cascade"
    gains = (
        Gain("kp", "1/s", "velocity set over the position's error", 1),
        Gain("kv", "N m s/rad", "torque over the velocity's error", 1),
        Gain("ki", "N m/rad", "torque over the integral of the velocity's error", 2),
    )
    integrates = True
    kp: np.ndarray
    kv: np.ndarray
    ki: np.ndarray
    integrator: Integrator = field(default_factory=Integrator)

    def proportional(self, error: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """kv (kp e + de) [N m]."""
        return self.kv * (self.kp * error + rate)

    def integration(self, error: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """ki (kp e + de) [N m/s]."""
        return self.ki * (self.kp * error + rate)

    @property
    def velocity_gain(self) -> np.ndarray:
        """kv [N m s/rad], (n,)."""
        return self.kv
