"""Computed torque: the feedback is an acceleration, which the nominal arm's inverse dynamics turns into torque."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.controller import Controller, Gain


@dataclass(frozen=True, kw_only=True)
class ComputedTorque(Controller):
    """tau = (M(q) + I) a + C(q, dq) dq + g(q) + f(dq_ref), a = ddq_ref + kp (q_ref - q) + kd (dq_ref - dq).

    All of the nominal arm, rotors I and friction f of the data sheet included. Friction is taken at the reference's
    velocity, as in the feedforward: at the measured one dry friction would chatter. Source: siciliano2009.

    Attributes:
        kp, kd: gains [1/s^2], [1/s], shape (n,).
    """

    kind = "computed_torque"
    gains = (
        Gain("kp", "1/s^2", "acceleration over the position's error", 2),
        Gain("kd", "1/s", "acceleration over the velocity's error", 1),
    )
    through_model = True
    kp: np.ndarray
    kd: np.ndarray

    def proportional(self, error: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """kp e + kd de [rad/s^2]."""
        return self.kp * error + self.kd * rate
