"""The two ways in which an engine takes the steps of ``RigidStep``."""

from __future__ import annotations

import numpy as np
from numpy import add, multiply, subtract

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.envs.drive.rigid_step import RigidStep
from gapscope.envs.engines.engine import Engine, RotorEngine

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
