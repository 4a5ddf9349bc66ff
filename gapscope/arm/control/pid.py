"""PID control of the position, beside a feedforward."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gapscope.arm.control.integrator import Integrator
from gapscope.arm.controller import Controller, Gain


@dataclass(frozen=True, kw_only=True)
class PID(Controller):
    """tau = feedforward + kp e + z + kd de, dz/dt = ki e, with e = q_ref - q.

    Attributes:
        kp, ki, kd: gains [N m/rad], [N m/(rad s)], [N m s/rad], shape (n,).
        integrator: bounds of z.
    """

    kind = "pid"
    gains = (
        Gain("kp", "N m/rad", "torque over the position's error", 2),
        Gain("ki", "N m/(rad s)", "torque over the integral of that error", 3),
        Gain("kd", "N m s/rad", "torque over the velocity's error", 1),
    )
    integrates = True
    kp: np.ndarray
    ki: np.ndarray
    kd: np.ndarray
    integrator: Integrator = field(default_factory=Integrator)

    def proportional(self, error: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """kp e + kd de [N m]."""
        return self.kp * error + self.kd * rate

    def integration(self, error: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """ki e [N m/s]."""
        return self.ki * error

    @property
    def velocity_gain(self) -> np.ndarray:
        """kd [N m s/rad], (n,)."""
        return self.kd
