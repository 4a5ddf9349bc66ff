"""PD control of the position, beside a feedforward."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.controller import Controller, Gain


@dataclass(frozen=True, kw_only=True)
class PD(Controller):
    """tau = feedforward + kp (q_ref - q) + kd (dq_ref - dq).

    Attributes:
        kp, kd: gains [N m/rad], [N m s/rad], shape (n,).
    """

    kind = "pd"
    gains = (
        Gain("kp", "N m/rad", "torque over the position's error", 2),
        Gain("kd", "N m s/rad", "torque over the velocity's error", 1),
    )
    kp: np.ndarray
    kd: np.ndarray

    def proportional(self, error: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """kp e + kd de [N m]."""
        return self.kp * error + self.kd * rate

    @property
    def velocity_gain(self) -> np.ndarray:
        """kd [N m s/rad], (n,)."""
        return self.kd
