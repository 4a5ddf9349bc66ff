"""One time step of the joints: rotors and friction solved with the mass matrix.

No engine knows load friction, or dry friction that really sticks, and not every one knows rotors. They enter as torque,
but not by their law at the present velocity: rotors would make an algebraic loop, dry friction would chatter. The
velocity after the step is solved from

    (M + I + dt b) a = u - h - f - b dq,   dq+ = dq + dt a,   f in limit Sgn(dq+),

with M and h of the loaded arm.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from arm.dynamics import RigidBody
from arm.forward import ForwardDynamics
from envs.drive.dry_friction import DryFriction

HOLD = 1e10
"""Inertia that holds a sticking joint [kg m^2]; what it takes of the torque is the friction."""
GUESSES = 6
"""Guesses at the sticking joints before the mass matrix is formed and the search is made sure to end."""


class RigidStep(ABC):
    """Steps of the bodies with rotors and friction, joints in kinematic order, all arrays of shape (n,).

    Guess which joints stick and which way the others slide: as in the step before. One pass of forward dynamics then
    gives dq+ and the friction, since that of sliding joints is known, and sticking joints are held by a huge inertia
    whose torque it is. Joints that contradict the guess change sides, and after a few guesses ``DryFriction`` decides.

    Args:
        body: the loaded arm.
        rotors: I [kg m^2].
        viscous: b [N m s/rad].
        dry: mask of the joints with dry friction.
        dt: time step [s].

    Attributes:
        q, dq: present positions [rad] and velocities [rad/s]; the arrays are updated in place.
    """

    def __init__(self, body: RigidBody, rotors: np.ndarray, viscous: np.ndarray, dry: np.ndarray, dt: float) -> None:
        n = len(rotors)
        self.q, self.dq = np.zeros((2, n))
        self._forward = ForwardDynamics(body, rotors)
        self._rotors, self._dt, self._any_dry = rotors, dt, bool(dry.any())
        self._dry, self._dry_mask = dry, dry.astype(float)
        self._friction, self._direction = DryFriction(n), np.zeros(n)
        self._out, self._work, self._velocity, self._taken, self._bound, self._braking = np.zeros((6, n))
        self._over = np.zeros(n, dtype=bool)
        self._nothing = self._over.tobytes()
        self.set_viscous(viscous)

    @abstractmethod
    def _set_rotors(self, rotors: np.ndarray) -> None:
        """Use this inertia [kg m^2] on the diagonal of the mass matrix."""

    @abstractmethod
    def _try(self, torque: np.ndarray) -> np.ndarray:
        """Acceleration [rad/s^2] under a torque [N m]; fills ``_velocity`` with dq+."""

    @abstractmethod
    def _accept(self) -> None:
        """Make the step that was tried last; ``_taken`` holds what rotors and sticking joints take of ``_out``."""

    @abstractmethod
    def _reject(self) -> None:
        """Take the step back that was tried last."""

    def reset(self) -> None:
        """Forget the step before: all joints rest."""
        self._friction.reset()
        self._assume(np.zeros(len(self._rotors)))

    def set_viscous(self, viscous: np.ndarray) -> None:
        """Change b [N m s/rad]."""
        self._viscous = viscous
        self._effective = self._rotors + self._dt * viscous
        self._assume(self._direction)

    def _assume(self, direction: np.ndarray) -> None:
        """Guess the directions of the joints with dry friction, 0 where they stick."""
        sticks = self._dry & (direction == 0)
        self._direction, self._signs = direction, direction.tobytes()
        self._sticks = bool(sticks.any())
        self._free, self._unbounded = 1.0 - sticks, np.where(sticks, 0.0, np.inf)
        self._all, self._brake = self._effective + HOLD * sticks, HOLD / self._dt * sticks
        self._set_rotors(self._all)

    def advance(self, torque: np.ndarray, limit: np.ndarray) -> None:
        """One step under u [N m], all that acts on the joints but friction and rotors; limit of dry friction [N m]."""
        if not self._any_dry:
            self._pass(torque, limit)
            self._accept()
            return
        for _ in range(GUESSES):
            self._pass(torque, limit)
            if self._confirmed(limit):
                self._accept()
                return
            self._reject()
        self._search(torque, limit)
        self._pass(torque, limit)
        self._velocity *= self._free
        self._accept()

    def _pass(self, torque: np.ndarray, limit: np.ndarray) -> None:
        """One pass of forward dynamics as guessed."""
        out, work = self._out, self._work
        np.multiply(self._viscous, self.dq, work)
        np.subtract(torque, work, out)
        if self._any_dry:
            np.multiply(self._direction, limit, work)
            np.subtract(out, work, out)
            if self._sticks:  # HOLD (a + dq / dt) = friction: the joint does not keep its velocity, it stops
                np.multiply(self._brake, self.dq, self._braking)
                np.subtract(out, self._braking, out)
        np.multiply(self._all, self._try(out), self._taken)

    def _confirmed(self, limit: np.ndarray) -> bool:
        """Whether the solution is as guessed; otherwise the next guess is made."""
        work, velocity, over = self._work, self._velocity, False
        if self._sticks:
            np.multiply(velocity, self._free, velocity)
            np.add(self._taken, self._braking, self._braking)
            np.abs(self._braking, work)
            np.add(limit, self._unbounded, self._bound)
            over = np.greater(work, self._bound, self._over).tobytes() != self._nothing
        np.multiply(velocity, self._dry_mask, work)
        if np.sign(work, work).tobytes() == self._signs and not over:
            return True
        direction = np.where(self._direction == work, self._direction, 0.0)
        self._assume(np.where(self._over, np.sign(self._braking), direction) if over else direction)
        return False

    def _search(self, torque: np.ndarray, limit: np.ndarray) -> None:
        """Find the sticking joints by a search that always ends."""
        dt = self._dt
        self._forward.set_rotors(self._effective)
        inertia = self._forward.mass_matrix(self.q)
        out = torque - self._viscous * self.dq
        momentum = inertia @ self.dq + dt * (out - self._forward.bias(self.q, self.dq))
        self._friction.solve(inertia, momentum, dt * limit)
        self._assume(np.where(self._dry, self._friction.direction, 0.0))
