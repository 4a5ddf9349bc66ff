"""A controller at work: from reference, position and velocity to torque, tick by tick."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.feedforward import feedforward
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm, smooth_sign


class Targets(NamedTuple):
    """What a controller is to follow, at one tick (n,) or at K of them (K, n).

    Attributes:
        q, dq, ddq: reference [rad], [rad/s], [rad/s^2].
        torque: feedforward [N m].
    """

    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    torque: np.ndarray

    @classmethod
    def of(
        cls,
        arm: NominalArm,
        controller: Controller,
        q: np.ndarray,
        dq: np.ndarray,
        ddq: np.ndarray,
    ) -> Targets:
        """A reference of K ticks with the feedforward that the controller takes of it."""
        torque = feedforward(arm, RigidBody(arm), controller.feedforward, q, dq, ddq)
        return cls(q, dq, ddq, torque)

    def at(self, tick: int | np.ndarray) -> Targets:
        """The commands of one tick, or of some of them."""
        return Targets(*(series[tick] for series in self))


class ControlLoop:
    """A controller of an arm with n joints, which is called once in each of its periods.

    Args:
        controller: the law and its gains.
        arm: the nominal arm, which feedforward and computed torque believe; its torque limit clips.

    Attributes:
        integral: torque of the integrator [N m], shape (n,); 0 at first.
    """

    def __init__(self, controller: Controller, arm: NominalArm) -> None:
        self.controller, self._arm = controller, arm
        self._body = RigidBody(arm)
        self._period = 1.0 / controller.rate
        self._limit: np.ndarray | float = (
            np.inf if arm.torque_limit is None else arm.torque_limit
        )
        self.integral = np.zeros(arm.n_joints)

    def __call__(self, commands: Targets, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Torque of this tick within the limit [N m].

        Args:
            commands: of this tick; of a law without an integrator also of K ticks at once.
            q, dq: position of the encoders [rad], the controller's velocity [rad/s], of the shape of the reference.
        """
        error, rate = commands.q - q, commands.dq - dq
        feedback = self.controller.proportional(error, rate)
        if self.controller.through_model:
            wanted = self._through_model(commands, q, dq, commands.ddq + feedback)
        else:
            wanted = commands.torque + feedback + self.integral
        applied = np.minimum(np.maximum(wanted, -self._limit), self._limit)
        if self.controller.integrator is not None:
            slope = self.controller.integration(error, rate)
            self.integral = self.controller.integrator.after(
                self.integral, slope, wanted, applied, self._period
            )
        return applied

    def start_with(
        self, torque: np.ndarray, commands: Targets, q: np.ndarray, dq: np.ndarray
    ) -> None:
        """Set an integrator so that this tick commands a torque [N m], shape (n,), as far as its limit allows."""
        integrator = self.controller.integrator
        if integrator is None:
            return
        feedback = self.controller.proportional(commands.q - q, commands.dq - dq)
        self.integral = integrator.bounded(torque - commands.torque - feedback)

    def _through_model(
        self, commands: Targets, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray
    ) -> np.ndarray:
        """Inverse dynamics of the nominal arm with friction of the reference's velocity [N m]."""
        inverse = self._body.torque if q.ndim == 1 else self._body.inverse_dynamics
        arm = self._arm
        friction = arm.coulomb * smooth_sign(commands.dq) + arm.viscous * commands.dq
        return inverse(q, dq, ddq) + arm.armature * ddq + friction
