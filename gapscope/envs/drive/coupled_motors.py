"""Motors that turn several joints in one time step: rotor, viscous and dry friction of their own speed.

A motor's speed is w = D_m dq, and what it takes, I dw/dt + b w + f with f in c(w) Sgn w, acts on its joints along
D_m^T. Explicit rotors would make an algebraic loop and dry friction would chatter, so w after the step is solved
together with the joints' own friction: the motors are joints more, tied to the others by a damper that is all but
rigid.
"""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.forward_dynamics import ForwardDynamics
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import DryLaw
from gapscope.envs.drive.dry_friction import DryFriction

TIE = 1e5
"""Inertia that ties a motor to its joints, over the largest of the mass matrix [1]."""


class CoupledMotors:
    """Torque that an arm's k coupled motors take from its n joints, in kinematic order.

    Args:
        arm: an arm with effects.
        body: its loaded rigid bodies.
        dt: time step [s].

    Attributes:
        present: whether a motor takes any.
    """

    def __init__(self, arm: CorrectedArm, body: RigidBody, dt: float) -> None:
        n, order = arm.arm.n_joints, body.order
        drives = np.eye(n) if arm.arm.coupling is None else arm.arm.coupling
        viscous = arm.quantity("motor_damping")
        rotors = arm.quantity("motor_rotor")
        dry = [x for x in arm.of_kind(DryLaw) if x[0].reach == "motor"]
        takes = sum((values[0] for _, values in dry), viscous + rotors)
        motors = np.flatnonzero(takes > 0)
        self.present = bool(len(motors))
        self._drives = drives[np.ix_(motors, order)]
        self._dry = [(law, [x[motors] for x in values]) for law, values in dry]
        self._dt = dt
        self._viscous, self._rotors = viscous[motors], rotors[motors]
        self._tied = np.hstack([self._drives, -np.eye(len(motors))])
        if self.present:
            self._forward = ForwardDynamics(body, np.zeros(n))
            self._friction = DryFriction(n + len(motors))

    def reset(self) -> None:
        """Forget the step before: all rests."""
        self._friction.reset()

    def __call__(
        self,
        q: np.ndarray,
        dq: np.ndarray,
        torque: np.ndarray,
        rotors: np.ndarray,
        viscous: np.ndarray,
        limit: np.ndarray,
    ) -> np.ndarray:
        """Torque taken [N m], (n,).

        Args:
            q, dq: positions [rad] and velocities [rad/s] before the step, (n,).
            torque: on the joints but friction and rotors [N m], (n,).
            rotors: the joints' own [kg m^2], (n,).
            viscous: their viscous friction [N m s/rad], (n,).
            limit: of their dry friction [N m], (n,).
        """
        dt, n = self._dt, len(q)
        self._forward.set_rotors(rotors + dt * viscous)
        inertia = self._forward.mass_matrix(q)
        out = torque - viscous * dq - self._forward.bias(q, dq)
        speed = self._drives @ dq
        own = self._rotors + dt * self._viscous
        together = TIE * inertia.max() * (self._tied.T @ self._tied)
        together[:n, :n] += inertia
        together[n:, n:] += np.diag(own)
        # a tie that holds before the step has no momentum
        momentum = np.concatenate([inertia @ dq + dt * out, self._rotors * speed])
        limits = dt * np.concatenate([limit, self._limit(speed)])
        after, impulse = self._friction.solve(together, momentum, limits)
        change = self._rotors * (after[n:] - speed) + impulse[n:]
        return np.asarray((change / dt + self._viscous * after[n:]) @ self._drives)

    def _limit(self, speed: np.ndarray) -> np.ndarray:
        """Limit of the motors' dry friction [N m], (k,), at their speeds [rad/s]."""
        limit = np.zeros_like(speed)
        for law, values in self._dry:
            limit += law.amplitude(speed, limit, *values)
        return limit
