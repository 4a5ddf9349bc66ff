"""One time step of the joints of many arms: rotors and friction solved with the mass matrix.

No engine has load friction, or dry friction that really sticks, and not every one has rotors. They enter as torque,
but not by their law at the present velocity: rotors would make an algebraic loop, dry friction would chatter. The
velocity after the step is solved from

    (M + I + dt b) a = u - h - f - b dq,   dq+ = dq + dt a,   f in limit Sgn(dq+),

with M and h of the loaded arm.
"""

from __future__ import annotations

import numpy as np
from numpy import absolute, add, greater, multiply, sign, subtract

from gapscope.arm.dynamics.rollout import ForwardDynamics
from gapscope.envs.drive.arm_drive import ArmDrive
from gapscope.envs.drive.laws import DryFriction
from gapscope.envs.engines import Bodies

HOLD = 1e10
"""Inertia that holds a sticking joint [kg m^2]; what it takes of the torque is the friction."""
GUESSES = 3
"""Guesses at the sticking joints before the mass matrix is formed and the search is made sure to end.

A joint that turns round within a step takes three. Of the steps whose third guess fails, hardly one in twenty would
find its solution by guessing on."""


class RigidStep:
    """Steps of N arms with rotors and friction, n joints in kinematic order.

    Arrays hold the joints of all arms in a row, (N n,), as those of ``Bodies``: numpy takes longer for tables.

    Guess which joints stick and which way the others slide: as in the step before. One pass of forward dynamics then
    gives dq+ and the friction, since that of sliding joints is known, and sticking joints are held by a huge inertia
    whose torque it is, HOLD (a + dq / dt): they do not keep a velocity, they stop. Arms whose joints contradict the
    guess try again with these joints on the other side, alone, so that every arm does what it does without the others,
    bit by bit; after a few guesses ``DryFriction`` decides.

    Args:
        bodies: moved by the steps.
        dt: time step [s].

    Attributes:
        q, dq: present positions [rad] and velocities [rad/s]; they are those of the bodies.
    """

    def __init__(self, bodies: Bodies, dt: float) -> None:
        self._bodies, self._dt = bodies, dt
        self.q, self.dq = bodies.position, bodies.velocity
        self._shape = count, n = bodies.rotors.shape
        self._drives: list[ArmDrive | None] = [None] * count
        self._forward: list[ForwardDynamics | None] = [None] * count
        self._friction = DryFriction(n)
        size = count * n
        # 1 at joints with dry friction and at those of them that stick, 0 elsewhere
        self._dry, self._sticks = np.zeros((2, size))
        self._rotors, self._viscous, self._effective, self._hold = np.zeros((4, size))
        self._direction, self._way = np.zeros((2, size))
        self._out, self._work, self._held, self._braking = np.zeros((4, size))
        self._over = np.zeros(size, dtype=bool)

    def _table(self, row: np.ndarray) -> np.ndarray:
        """The same memory with a row for each arm, (N, n)."""
        return row.reshape(self._shape)

    def put(self, number: int, drive: ArmDrive) -> None:
        """Give an arm, numbered from 0, other rotors and friction; ``reset`` has to follow.

        Motors of their own keep their rotors and their friction.
        """
        self._drives[number], self._forward[number] = drive, None
        self._table(self._rotors)[number] = np.where(drive.rigid, drive.rotors, 0.0)
        self._table(self._dry)[number] = drive.friction.dry & drive.rigid
        self._any_dry, self._all_dry = bool(self._dry.any()), bool(self._dry.all())
        self._coupled = [
            (arm, one.coupled)
            for arm, one in enumerate(self._drives)
            if one is not None and one.coupled.present
        ]

    def reset(self, number: int, viscous: np.ndarray) -> None:
        """Forget the steps of an arm: all its joints rest; viscous friction b of all arms [N m s/rad]."""
        drive = self._drives[number]
        assert drive is not None
        if drive.coupled.present:
            drive.coupled.reset()
        self._table(self._direction)[number] = 0.0
        self._guess(self._direction)
        self.set_viscous(viscous)

    def set_viscous(self, viscous: np.ndarray) -> None:
        """Change b [N m s/rad]."""
        self._viscous[...] = viscous
        self._effective = self._rotors + self._dt * viscous
        self._set_inertia()

    def advance(self, torque: np.ndarray, limit: np.ndarray) -> None:
        """One step under u [N m], all that acts on the joints but friction and rotors; limit of dry friction [N m]."""
        bodies, work = self._bodies, self._work
        if self._coupled:
            torque = torque - self._taken(torque, limit)
        # with dt b in the inertia: b times the velocity after the step
        multiply(self._viscous, self.dq, work)
        if not self._any_dry:
            subtract(torque, work, bodies.force)
            bodies.step()
            bodies.accept()
            return
        subtract(torque, work, self._out)
        # once it rests, what sticks has no velocity to brake
        if not self._try(limit, brakes=bodies.new):
            self._again(limit)
        bodies.new = False
        bodies.accept(self._any_stuck)

    def _taken(self, torque: np.ndarray, limit: np.ndarray) -> np.ndarray:
        """Torque that motors take which turn several joints [N m], under that on the joints."""
        taken = np.zeros_like(torque)
        for arm, motors in self._coupled:
            q, dq, u, rotors, viscous, dry, out = (
                self._table(row)[arm]
                for row in (
                    *(self.q, self.dq, torque, self._rotors, self._viscous),
                    *(limit, taken),
                )
            )
            out[:] = motors(q, dq, u, rotors, viscous, dry)
        return taken

    def _guess(self, direction: np.ndarray) -> None:
        """Guess the directions of the joints; of those with dry friction 0 sticks."""
        # compared as bytes; sign makes no -0, so that equal directions have equal bytes
        self._direction, self._signs = direction, direction.tobytes()
        # a joint with dry friction that has no direction
        self._sticks = self._dry - absolute(direction)
        (self._stuck,) = self._sticks.nonzero()
        self._any_stuck, self._over[...] = len(self._stuck) > 0, False
        self._hold = HOLD * self._sticks
        self._brake = self._hold / self._dt
        self._set_inertia()

    def _set_inertia(self) -> None:
        """Have the bodies step with what sticks held."""
        inertia = self._effective + self._hold
        # a joint that slides is held by nothing
        self._holding = inertia * self._sticks
        self._bodies.set_rotors(inertia)

    def _try(
        self, limit: np.ndarray, brakes: bool, only: np.ndarray | None = None
    ) -> bool:
        """Try the step, with limits of dry friction [N m]; whether it is as guessed.

        ``only``: numbers of the arms that try again, shape (k,); the others are left as they are.
        """
        bodies, work, held, way = self._bodies, self._work, self._held, self._way
        force, ahead, stuck = bodies.force, bodies.ahead, self._any_stuck
        multiply(self._direction, limit, work)
        subtract(self._out, work, force)
        if stuck and brakes:
            multiply(self._brake, self.dq, self._braking)
            subtract(force, self._braking, force)
        bodies.step(only)
        if stuck:
            # held by a huge inertia, they still creep by what that lets through
            ahead[self._stuck] = 0.0
            # of the joints that stick, what holds them is the friction
            multiply(self._holding, bodies.acceleration, held)
            if brakes:
                add(held, self._braking, held)
            # friction would have to give more than its limit: it breaks loose
            greater(absolute(held, work), limit, self._over)
            stuck = np.count_nonzero(self._over) > 0
        # a joint without dry friction has no way
        sign(ahead if self._all_dry else multiply(ahead, self._dry, way), way)
        return not stuck and way.tobytes() == self._signs

    def _again(self, limit: np.ndarray) -> None:
        """Find the step of the arms whose first guess was wrong; limits of dry friction [N m]."""
        for guesses in range(1, GUESSES + 1):
            # what went another way than guessed sticks, and what was not held goes where it was pushed
            kept = np.where(self._way == self._direction, self._way, 0.0)
            guess = kept + self._over * sign(self._held)
            wrong = self._table(guess != self._direction).any(axis=1)
            arms = np.flatnonzero(wrong).astype(np.int32)
            # guesses have not settled: the search does, and this try is the last
            if guesses == GUESSES:
                for arm in arms.tolist():
                    self._search(arm, limit, self._table(guess)[arm])
            self._guess(guess)
            if self._try(limit, True, arms):
                return

    def _search(self, arm: int, limit: np.ndarray, guess: np.ndarray) -> None:
        """Replace a guess at the directions of an arm's joints, shape (n,), by a search that always ends."""
        q, dq, out, most, rotors, effective, dry = (
            self._table(row)[arm]
            for row in (
                *(self.q, self.dq, self._out, limit),
                *(self._rotors, self._effective, self._dry),
            )
        )
        drive, forward = self._drives[arm], self._forward[arm]
        assert drive is not None
        if forward is None:
            forward = ForwardDynamics(drive.body, rotors)
            self._forward[arm] = forward
        forward.set_rotors(effective)
        inertia = forward.mass_matrix(q)
        # dt b dq in the product with the inertia cancels b dq in the torque
        momentum = inertia @ dq + self._dt * (out - forward.bias(q, dq))
        self._friction.direction = guess.copy()
        self._friction.solve(inertia, momentum, self._dt * most)
        guess[:] = np.where(dry, self._friction.direction, 0.0)
