"""One time step of the joints: rotors and friction solved with the mass matrix.

No engine has load friction, or dry friction that really sticks, and not every one has rotors. They enter as torque,
but not by their law at the present velocity: rotors would make an algebraic loop, dry friction would chatter. The
velocity after the step is solved from

    (M + I + dt b) a = u - h - f - b dq,   dq+ = dq + dt a,   f in limit Sgn(dq+),

with M and h of the loaded arm.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np
from numpy import add, multiply, sign, subtract

from gapscope.arm.dynamics.forward_dynamics import ForwardDynamics
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.envs.drive.friction import CoupledMotors, DryFriction
from gapscope.envs.engines import Engine, RotorEngine

HOLD = 1e10
"""Inertia that holds a sticking joint [kg m^2]; what it takes of the torque is the friction."""
GUESSES = 3
"""Guesses at the sticking joints before the mass matrix is formed and the search is made sure to end.

A joint that turns round within a step takes three. Of the steps whose third guess fails, hardly one in twenty would
find its solution by guessing on."""


class RigidStep(ABC):
    """Steps of the bodies with rotors and friction, joints in kinematic order, all arrays of shape (n,).

    Guess which joints stick and which way the others slide: as in the step before. One pass of forward dynamics then
    gives dq+ and the friction, since that of sliding joints is known, and sticking joints are held by a huge inertia
    whose torque it is, HOLD (a + dq / dt): they do not keep a velocity, they stop. Joints that contradict the guess
    change sides, and after a few guesses ``DryFriction`` decides.

    Args:
        body: the loaded arm.
        rotors: I [kg m^2].
        viscous: b [N m s/rad].
        dry: mask of the joints with dry friction.
        dt: time step [s].

    Attributes:
        coupled: motors that turn several joints, if there are any.
        q, dq: present positions [rad] and velocities [rad/s]; the arrays are updated in place.
    """

    def __init__(
        self,
        body: RigidBody,
        rotors: np.ndarray,
        viscous: np.ndarray,
        dry: np.ndarray,
        dt: float,
    ) -> None:
        n = len(rotors)
        self.coupled: CoupledMotors | None = None
        self.q, self.dq = np.zeros((2, n))
        self._body = body
        self._rotors, self._dt, self._any_dry = rotors, dt, bool(dry.any())
        self._dry, self._dry_mask, self._all_dry = (
            dry,
            dry.astype(float),
            bool(dry.all()),
        )
        self._friction, self._direction = DryFriction(n), np.zeros(n)
        self._out, self._work, self._velocity, self._braking = np.zeros((4, n))
        self._sticking = np.zeros(n, dtype=bool)
        self._steps = np.full(n, dt)
        self.set_viscous(viscous)
        self._assume(self._direction)

    @cached_property
    def _forward(self) -> ForwardDynamics:
        return ForwardDynamics(self._body, self._rotors)

    @abstractmethod
    def _set_rotors(self, rotors: np.ndarray) -> None:
        """Use this inertia [kg m^2] on the diagonal of the mass matrix."""

    @abstractmethod
    def _try(self, torque: np.ndarray) -> np.ndarray:
        """Acceleration [rad/s^2] under a torque [N m]; fills ``_velocity`` with dq+."""

    @abstractmethod
    def _accept(self, acceleration: np.ndarray) -> None:
        """Make the step that was tried last, with its acceleration [rad/s^2]."""

    @abstractmethod
    def _reject(self) -> None:
        """Take the step back that was tried last."""

    def reset(self) -> None:
        """Forget the step before: all joints rest."""
        self._friction.reset()
        if self.coupled is not None:
            self.coupled.reset()
        self._assume(np.zeros(len(self._rotors)))

    def set_viscous(self, viscous: np.ndarray) -> None:
        """Change b [N m s/rad]."""
        self._viscous = viscous
        self._effective = self._rotors + self._dt * viscous
        self._all = self._effective + HOLD * self._sticking
        self._set_rotors(self._all)

    def _assume(self, direction: np.ndarray) -> None:
        """Guess the directions of the joints with dry friction, 0 if they stick."""
        sticks = self._dry & (direction == 0)
        self._sticking, self._at_rest = sticks, False
        self._direction, self._signs = direction, direction.tobytes()
        hold = HOLD * sticks
        self._all, self._brake = self._effective + hold, hold / self._dt
        self._stuck = [
            (joint, self._all.item(joint)) for joint in sticks.nonzero()[0].tolist()
        ]
        self._set_rotors(self._all)

    def advance(self, torque: np.ndarray, limit: np.ndarray) -> None:
        """One step under u [N m], all that acts on the joints but friction and rotors; limit of dry friction [N m]."""
        if self.coupled is not None:
            own = self._rotors, self._viscous, limit
            torque = torque - self.coupled(self.q, self.dq, torque, *own)
        if not self._any_dry:
            multiply(self._viscous, self.dq, self._work)
            subtract(torque, self._work, self._out)
            self._accept(self._try(self._out))
            return
        for _ in range(GUESSES):
            acceleration = self._pass(torque, limit)
            if self._stuck:
                confirmed = self._still_sticks(acceleration, limit)
            else:
                confirmed = self._slides_as_guessed()
                if not confirmed:
                    self._assume(
                        np.where(self._direction == self._work, self._direction, 0.0)
                    )
            if confirmed:
                self._at_rest = True
                self._accept(acceleration)
                return
            self._reject()
        self._search(torque, limit)
        acceleration = self._pass(torque, limit)
        self._velocity[self._sticking] = 0.0
        self._accept(acceleration)

    def _pass(self, torque: np.ndarray, limit: np.ndarray) -> np.ndarray:
        """One pass of forward dynamics as guessed; the acceleration [rad/s^2]."""
        out, work, dq = self._out, self._work, self.dq
        multiply(self._viscous, dq, work)
        subtract(torque, work, out)
        multiply(self._direction, limit, work)
        subtract(out, work, out)
        if self._stuck and not self._at_rest:
            multiply(self._brake, dq, self._braking)
            subtract(out, self._braking, out)
        return self._try(out)

    def _slides_as_guessed(self) -> bool:
        """Whether the joints with dry friction move as guessed; ``_work`` is their directions, 0 elsewhere."""
        velocity = self._velocity
        if not self._all_dry:
            velocity = multiply(velocity, self._dry_mask, self._work)
        return sign(velocity, self._work).tobytes() == self._signs

    def _still_sticks(self, acceleration: np.ndarray, limit: np.ndarray) -> bool:
        """Whether a solution with sticking joints is as guessed; otherwise the next guess is made.

        Of the few joints that stick, one at a time: for them numbers are faster than arrays.
        """
        velocity, over = self._velocity, {}
        for joint, inertia in self._stuck:
            friction = inertia * acceleration.item(joint)
            if not self._at_rest:
                friction += self._braking.item(joint)
            velocity[joint] = 0.0
            if abs(friction) > limit.item(joint):
                over[joint] = 1.0 if friction > 0 else -1.0
        if self._slides_as_guessed() and not over:
            return True
        direction = np.where(self._direction == self._work, self._direction, 0.0)
        for joint, way in over.items():
            direction[joint] = way
        self._assume(direction)
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


READ_EVERY = 20
"""Steps after which the engine is asked for its state: rounding would grow, since the torque given is no feedback."""
NEAR_LIMIT = 0.1
"""Distance from a joint's limit [rad] within which the engine is asked for its state after every step."""


class Predicted(RigidStep):
    """For an engine without rotors: the step is solved first, and M a + h, the torque that makes it, is given on.

    Away from limits the engine's next state is the one solved for, to rounding, and is read now and then only.
    """

    def __init__(
        self,
        engine: Engine,
        body: RigidBody,
        rotors: np.ndarray,
        viscous: np.ndarray,
        dry: np.ndarray,
        dt: float,
        limits: np.ndarray,
    ) -> None:
        """As ``RigidStep``; ``limits`` are the joints' lower and upper limits [rad], shape (2, n)."""
        self._engine, self._unread = engine, 0
        self._lowest, self._highest = limits[0] + NEAR_LIMIT, limits[1] - NEAR_LIMIT
        # one product with the acceleration: the torque of rotors, friction and what holds, and the gain in velocity
        self._factors = np.full((2, len(rotors)), dt)
        self._products = np.zeros_like(self._factors)
        self._held, self._gained = self._products
        super().__init__(body, rotors, viscous, dry, dt)
        self._accelerate = self._forward.acceleration

    def reset(self) -> None:
        """Take the engine's state and forget the step before."""
        super().reset()
        self.read()

    def read(self) -> None:
        """Take the engine's state, which includes joint limits."""
        self._engine.read()
        np.copyto(self.q, self._engine.q)
        np.copyto(self.dq, self._engine.dq)
        self._unread, self._at_rest = 0, False
        self._near = bool(
            np.count_nonzero((self.q < self._lowest) | (self.q > self._highest))
        )

    def _set_rotors(self, rotors: np.ndarray) -> None:
        self._factors[0] = rotors
        self._forward.set_rotors(rotors)

    def _try(self, torque: np.ndarray) -> np.ndarray:
        acceleration = self._accelerate(self.q, self.dq, torque)
        multiply(self._factors, acceleration, self._products)
        add(self._gained, self.dq, self._velocity)
        return acceleration

    def _accept(self, acceleration: np.ndarray) -> None:
        work = self._work
        subtract(self._out, self._held, work)
        self._engine.step(work)
        self._unread += 1
        if self._near or self._unread == READ_EVERY:
            self.read()
            return
        self.dq, self._velocity = self._velocity, self.dq
        multiply(self.dq, self._steps, work)
        add(self.q, work, self.q)

    def _reject(self) -> None:
        """Nothing: it was only thought."""


class Native(RigidStep):
    """For an engine with rotors: it makes the step itself, and takes it back if the guess was wrong."""

    def __init__(
        self,
        engine: RotorEngine,
        body: RigidBody,
        rotors: np.ndarray,
        viscous: np.ndarray,
        dry: np.ndarray,
        dt: float,
    ) -> None:
        """As ``RigidStep``."""
        self._engine = engine
        super().__init__(body, rotors, viscous, dry, dt)
        self.q, self.dq, self._velocity = (
            engine.position,
            engine.velocity,
            engine.velocity,
        )

    def read(self) -> None:
        """Nothing: the state is the engine's."""

    def _set_rotors(self, rotors: np.ndarray) -> None:
        self._engine.set_rotors(rotors)

    def _try(self, torque: np.ndarray) -> np.ndarray:
        return self._engine.advance(torque)

    def _accept(self, acceleration: np.ndarray) -> None:
        """Nothing: it is done."""

    def _reject(self) -> None:
        self._engine.undo()
