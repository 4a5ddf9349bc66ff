"""One time step of the joints of many arms: ``gapscope.envs.drive.rigid_step`` over N arms at once.

The same guesses in the same order as for one arm, so that the result is the same bit by bit: all arms take the step as
they guess, and those whose joints contradict the guess take it back and try again, alone.
"""

from __future__ import annotations

import numpy as np
from numpy import add, multiply, subtract

from gapscope.arm.dynamics.forward_dynamics import ForwardDynamics
from gapscope.envs.drive.arm_drive import ArmDrive
from gapscope.envs.drive.friction import DryFriction
from gapscope.envs.drive.rigid_step import GUESSES, HOLD
from gapscope.envs.engines.mujoco import MuJoCoBatch


class ArmsStep:
    """Steps of N arms with rotors and friction, n joints in kinematic order, all arrays of shape (N, n).

    Args:
        engine: moves the bodies.
        dt: time step [s].

    Attributes:
        q, dq: present positions [rad] and velocities [rad/s]; they are the engine's.
    """

    def __init__(self, engine: MuJoCoBatch, dt: float) -> None:
        self._engine, self._dt = engine, dt
        self.q, self.dq = engine.position, engine.velocity
        shape = self.q.shape
        self._drives: list[ArmDrive | None] = [None] * shape[0]
        self._forward: list[ForwardDynamics | None] = [None] * shape[0]
        self._friction = [DryFriction(shape[1]) for _ in range(shape[0])]
        self._dry, self._sticking = np.zeros((2, *shape), dtype=bool)
        self._rotors, self._viscous, self._effective, self._brake = np.zeros(
            (4, *shape)
        )
        self._direction, self._mask = np.zeros((2, *shape))
        self._out, self._work, self._old_q, self._old_dq, self._new_dq = np.zeros(
            (5, *shape)
        )
        self._any_dry = self._any_stuck = False

    def put(self, number: int, drive: ArmDrive) -> None:
        """Give an arm, numbered from 0, other rotors and friction; ``reset`` has to follow."""
        self._drives[number], self._forward[number] = drive, None
        self._rotors[number], self._dry[number] = drive.rotors, drive.friction.dry
        self._mask[number] = drive.friction.dry
        self._any_dry = bool(self._dry.any())

    def reset(self, number: int, viscous: np.ndarray) -> None:
        """Forget the steps of an arm: all its joints rest; viscous friction b [N m s/rad], shape (n,)."""
        self._friction[number].reset()
        self._viscous[number] = viscous
        self._effective[number] = self._rotors[number] + self._dt * viscous
        self._keep(np.array([number]), np.zeros((1, self.q.shape[1])))
        rotors = self._effective[number] + HOLD * self._sticking[number]
        self._engine.rotors[number] = rotors

    def set_viscous(self, viscous: np.ndarray) -> None:
        """Change b [N m s/rad]."""
        self._viscous[:] = viscous
        self._effective = self._rotors + self._dt * self._viscous
        self._engine.rotors[:] = self._effective + HOLD * self._sticking

    def begin(self) -> np.ndarray:
        """Note the state before a step; the velocities [rad/s], valid until the next call."""
        np.copyto(self._old_dq, self.dq)
        return self._old_dq

    def advance(self, torque: np.ndarray, limit: np.ndarray) -> None:
        """One step, begun before, under u [N m], all that acts on the joints but friction and rotors.

        Args:
            torque: u.
            limit: of dry friction [N m].
        """
        out, work, old = self._out, self._work, self._old_dq
        multiply(self._viscous, old, work)
        subtract(torque, work, out)
        if not self._any_dry:
            self._engine.step(out)
            return
        np.copyto(self._old_q, self.q)
        multiply(self._direction, limit, work)
        subtract(out, work, out)
        if self._any_stuck:
            # what rests has no velocity to brake
            multiply(self._brake, old, work)
            subtract(out, work, out)
        self._engine.step(out)
        velocity = self._new_dq
        np.copyto(velocity, self.dq)
        if self._any_stuck:
            velocity[self._sticking] = 0.0
            self.dq[:] = velocity
            # of the joints that stick, what holds them is the friction
            multiply(self._engine.rotors, self._engine.acceleration, out)
            add(out, work, out)
            over = (np.abs(out, work) > limit) & self._sticking
        multiply(velocity, self._mask, work)
        way = np.sign(work, work)
        wrong = way != self._direction
        if self._any_stuck:
            wrong |= over
        if not wrong.any():
            return
        arms = np.flatnonzero(wrong.any(axis=1)).astype(np.int32)
        kept = np.where(self._direction[arms] == way[arms], way[arms], 0.0)
        if self._any_stuck:
            pushed = np.where(out[arms] > 0, 1.0, -1.0)
            kept = np.where(over[arms], pushed, kept)
        self._again(arms, kept, torque[arms], limit[arms])

    def _again(
        self,
        arms: np.ndarray,
        direction: np.ndarray,
        torque: np.ndarray,
        limit: np.ndarray,
    ) -> None:
        """Steps of some arms, k of them, whose first guess was wrong; directions, torque and limit of shape (k, n)."""
        old = self._old_dq[arms]
        work = torque - self._viscous[arms] * old
        known = (old, work, limit, self._dry[arms], self._effective[arms])
        left, guess = np.arange(len(arms)), direction.copy()
        for _ in range(GUESSES - 1):
            wrong, following = self._try(
                arms[left], guess[left], tuple(x[left] for x in known)
            )
            left = left[wrong]
            if not len(left):
                break
            guess[left] = following[wrong]
        if len(left):
            self._take_back(arms[left])
            for row in left.tolist():
                guess[row] = self._search(int(arms[row]), torque[row], limit[row])
            self._try(arms[left], guess[left], tuple(x[left] for x in known))
        self._keep(arms, guess)

    def _keep(self, arms: np.ndarray, direction: np.ndarray) -> None:
        """Note the directions, shape (k, n), with which some arms have made their step."""
        sticks = self._dry[arms] & (direction == 0)
        self._direction[arms], self._sticking[arms] = direction, sticks
        self._brake[arms] = HOLD * sticks / self._dt
        self._any_stuck = bool(self._sticking.any())

    def _try(
        self,
        arms: np.ndarray,
        direction: np.ndarray,
        known: tuple[np.ndarray, ...],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Take the step of some arms back and make it as guessed; which of them are wrong, and the next guesses.

        Args:
            arms: k numbers.
            direction: guessed, shape (k, n).
            known: velocity before the step [rad/s], torque less viscous friction [N m], limit of dry friction [N m],
                where there is dry friction, and rotors with viscous friction [kg m^2], each (k, n).
        """
        old, work, limit, dry, effective = known
        stuck = dry & (direction == 0)
        hold = HOLD * stuck
        inertia, braking = effective + hold, hold / self._dt * old
        self._take_back(arms)
        self._engine.rotors[arms] = inertia
        self._engine.step(work - direction * limit - braking, only=arms)
        velocity = np.where(stuck, 0.0, self.dq[arms])
        self.dq[arms] = velocity
        held = inertia * self._engine.acceleration[arms] + braking
        over = stuck & (np.abs(held) > limit)
        way = np.sign(velocity * dry)
        kept = np.where(direction == way, direction, 0.0)
        following = np.where(over, np.where(held > 0, 1.0, -1.0), kept)
        wrong = ((way != direction) | over).any(axis=1)
        return np.flatnonzero(wrong), following

    def _take_back(self, arms: np.ndarray) -> None:
        """Put some arms back to where they were before the step."""
        self.q[arms], self.dq[arms] = self._old_q[arms], self._old_dq[arms]

    def _search(self, arm: int, torque: np.ndarray, limit: np.ndarray) -> np.ndarray:
        """Directions of an arm's joints by a search that always ends, 0 if they stick, shape (n,)."""
        drive, forward = self._drives[arm], self._forward[arm]
        assert drive is not None
        if forward is None:
            forward = ForwardDynamics(drive.body, self._rotors[arm])
            self._forward[arm] = forward
        q, dq, dt = self._old_q[arm], self._old_dq[arm], self._dt
        forward.set_rotors(self._effective[arm])
        inertia = forward.mass_matrix(q)
        out = torque - self._viscous[arm] * dq
        momentum = inertia @ dq + dt * (out - forward.bias(q, dq))
        self._friction[arm].solve(inertia, momentum, dt * limit)
        return np.where(self._dry[arm], self._friction[arm].direction, 0.0)
