"""One time step of the joints of many arms: rotors and friction solved with the mass matrix.

No engine has load friction, or dry friction that really sticks, and not every one has rotors. They enter as torque,
but not by their law at the present velocity: rotors would make an algebraic loop, dry friction would chatter. The
velocity after the step is solved from

    (M + I + dt b) a = u - h - f - b dq,   dq+ = dq + dt a,   f in limit Sgn(dq+),

with M and h of the loaded arm.
"""

from __future__ import annotations

import numpy as np
from numpy import absolute, add, greater, logical_and, multiply, sign, subtract

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.dynamics.rollout import ForwardDynamics
from gapscope.envs.drive.arm_drive import ArmDrive
from gapscope.envs.drive.friction import DryFriction
from gapscope.envs.engines import Bodies, Engine

HOLD = 1e10
"""Inertia that holds a sticking joint [kg m^2]; what it takes of the torque is the friction."""
GUESSES = 3
"""Guesses at the sticking joints before the mass matrix is formed and the search is made sure to end.

A joint that turns round within a step takes three. Of the steps whose third guess fails, hardly one in twenty would
find its solution by guessing on."""
READ_EVERY = 20
"""Steps after which the engine is asked for its state: rounding would grow, since the torque given is no feedback."""
NEAR_LIMIT = 0.1
"""Distance from a joint's limit [rad] within which the engine is asked for its state after every step."""


class Predicted(Bodies):
    """One arm in an engine without rotors: a step is solved first, and M a + h, the torque that makes it, is given on.

    Away from limits the engine's next state is the one solved for, to rounding, and is read now and then only.

    Args:
        engine: moves the bodies.
        body: the loaded arm.
        limits: the joints' lower and upper limits [rad], shape (2, n).
        dt: time step [s].
    """

    def __init__(
        self, engine: Engine, body: RigidBody, limits: np.ndarray, dt: float
    ) -> None:
        n = body.n_joints
        self._engine, self._unread, self._near = engine, 0, False
        self.new = True
        self._lowest, self._highest = limits[0] + NEAR_LIMIT, limits[1] - NEAR_LIMIT
        self.position, self.velocity, self.acceleration, self.rotors = np.zeros(
            (4, 1, n)
        )
        self._forward = ForwardDynamics(body, np.zeros(n))
        # one product with the acceleration: the torque of rotors, friction and what holds, and the gain in velocity
        self._factors, self._products = np.full((2, n), dt), np.zeros((2, n))
        self._work, self._steps = np.zeros(n), np.full(n, dt)
        self._q, self._dq = self.position[0], self.velocity[0]
        self._last, (self._held, self._gained) = self.acceleration[0], self._products
        self._accelerate = self._forward.acceleration

    def reset(self, number: int, q: np.ndarray, dq: np.ndarray) -> None:
        """Put the arm at positions q [rad or m] with velocities dq, shape (n,)."""
        self._engine.reset(q, dq)
        self._read()

    def set_rotors(self, arms: int | slice | np.ndarray, rotors: np.ndarray) -> None:
        """Change the inertia on the diagonal of the mass matrix [kg m^2]."""
        self.rotors[arms] = rotors
        self._factors[0] = self.rotors[0]
        self._forward.set_rotors(self.rotors[0])

    def run(self, torque: np.ndarray, count: int) -> None:
        """Hold joint torque [N m or N], shape (1, n), for ``count`` time steps of the bodies alone."""
        self._engine.step(torque[0], count)
        self._read()

    def step(self, torque: np.ndarray, only: np.ndarray | None = None) -> None:
        """Solve a step under joint torque [N m or N], shape (1, n): its acceleration and the velocity after it."""
        self._torque = torque[0]
        acceleration = self._accelerate(self._q, self._dq, self._torque)
        multiply(self._factors, acceleration, self._products)
        add(self._gained, self._dq, self._dq)
        np.copyto(self._last, acceleration)

    def accept(self) -> None:
        """Make the step that was solved last."""
        work = self._work
        subtract(self._torque, self._held, work)
        self._engine.step(work)
        self._unread += 1
        if self._near or self._unread == READ_EVERY:
            self._read()
            return
        multiply(self._dq, self._steps, work)
        add(self._q, work, self._q)

    def _read(self) -> None:
        """Take the engine's state, which includes joint limits."""
        self._engine.read()
        q = self._q
        np.copyto(q, self._engine.q)
        np.copyto(self._dq, self._engine.dq)
        self._unread, self.new = 0, True
        self._near = bool(np.count_nonzero((q < self._lowest) | (q > self._highest)))

    def close(self) -> None:
        """Free the engine's world; a second call does nothing."""
        self._engine.close()


class RigidStep:
    """Steps of N arms with rotors and friction, n joints in kinematic order, all arrays of shape (N, n).

    Guess which joints stick and which way the others slide: as in the step before. One pass of forward dynamics then
    gives dq+ and the friction, since that of sliding joints is known, and sticking joints are held by a huge inertia
    whose torque it is, HOLD (a + dq / dt): they do not keep a velocity, they stop. Arms whose joints contradict the
    guess take the step back and try again with these joints on the other side, alone, so that every arm does what it
    does without the others, bit by bit; after a few guesses ``DryFriction`` decides.

    Args:
        bodies: moved by the steps.
        dt: time step [s].

    Attributes:
        q, dq: present positions [rad] and velocities [rad/s]; they are those of the bodies.
    """

    def __init__(self, bodies: Bodies, dt: float) -> None:
        self._bodies, self._dt = bodies, dt
        self.q, self.dq = bodies.position, bodies.velocity
        shape = self.q.shape
        self._drives: list[ArmDrive | None] = [None] * shape[0]
        self._forward: list[ForwardDynamics | None] = [None] * shape[0]
        self._friction = [DryFriction(shape[1]) for _ in range(shape[0])]
        self._dry, self._sticking, self._over = np.zeros((3, *shape), dtype=bool)
        self._rotors, self._viscous, self._effective, self._brake = np.zeros(
            (4, *shape)
        )
        self._direction, self._mask, self._way = np.zeros((3, *shape))
        self._out, self._work, self._held, self._old_q, self._old_dq = np.zeros(
            (5, *shape)
        )
        self._any_dry = self._any_stuck = False
        # of one arm rows: numpy takes longer for tables
        self.shape = shape[1:] if shape[0] == 1 else shape
        tables = (
            *(self.q, self.dq, bodies.acceleration, bodies.rotors, self._viscous),
            *(self._brake, self._direction, self._mask, self._way, self._out),
            *(self._work, self._held, self._old_q, self._old_dq, self._sticking),
            self._over,
        )
        self._rows = tuple(table.reshape(self.shape) for table in tables)

    def put(self, number: int, drive: ArmDrive) -> None:
        """Give an arm, numbered from 0, other rotors and friction; ``reset`` has to follow.

        Motors of their own keep their rotors and their friction.
        """
        self._drives[number], self._forward[number] = drive, None
        self._rotors[number] = np.where(drive.rigid, drive.rotors, 0.0)
        self._dry[number] = self._mask[number] = drive.friction.dry & drive.rigid
        self._any_dry = bool(self._dry.any())
        self._coupled = [
            (arm, one.coupled)
            for arm, one in enumerate(self._drives)
            if one is not None and one.coupled.present
        ]

    def reset(self, number: int, viscous: np.ndarray) -> None:
        """Forget the steps of an arm: all its joints rest; viscous friction b [N m s/rad], shape (n,)."""
        self._friction[number].reset()
        drive = self._drives[number]
        assert drive is not None
        if drive.coupled.present:
            drive.coupled.reset()
        self._viscous[number] = viscous
        self._effective[number] = self._rotors[number] + self._dt * viscous
        self._keep(np.array([number]), np.zeros((1, self.q.shape[1])))
        rotors = self._effective[number] + HOLD * self._sticking[number]
        self._bodies.set_rotors(number, rotors)

    def set_viscous(self, viscous: np.ndarray) -> None:
        """Change b [N m s/rad]."""
        self._viscous[:] = viscous
        self._effective = self._rotors + self._dt * self._viscous
        rotors = self._effective + HOLD * self._sticking
        self._bodies.set_rotors(slice(None), rotors)

    def advance(self, torque: np.ndarray, limit: np.ndarray) -> None:
        """One step under u [N m], all that acts on the joints but friction and rotors.

        Args:
            torque: u, of the step's own ``shape``.
            limit: of dry friction [N m], of that shape.
        """
        q, velocity, acceleration, inertia, viscous, brake, direction, *more = (
            self._rows
        )
        mask, way, out, work, held, old_q, old, sticking, over = more
        bodies, stuck = self._bodies, self._any_stuck
        if self._coupled:
            torque = torque - self._taken(torque, limit)
        np.copyto(old, velocity)
        multiply(viscous, old, work)
        subtract(torque, work, out)
        if not self._any_dry:
            bodies.step(self._out)
            bodies.accept()
            return
        np.copyto(old_q, q)
        multiply(direction, limit, work)
        subtract(out, work, out)
        brakes = stuck and bodies.new
        if brakes:
            # once it rests, what sticks has no velocity to brake
            multiply(brake, old, work)
            subtract(out, work, out)
        bodies.new = False
        bodies.step(self._out)
        if stuck:
            np.copyto(velocity, 0.0, where=sticking)
            # of the joints that stick, what holds them is the friction
            multiply(inertia, acceleration, held)
            if brakes:
                add(held, work, held)
            greater(absolute(held, work), limit, over)
            logical_and(over, sticking, over)
            stuck = np.count_nonzero(over) > 0
        multiply(velocity, mask, way)
        signs = sign(way, way).tobytes()
        if stuck or signs != self._signs:
            shape = self.q.shape
            self._again(torque.reshape(shape), limit.reshape(shape))
        bodies.accept()

    def _taken(self, torque: np.ndarray, limit: np.ndarray) -> np.ndarray:
        """Torque that motors take which turn several joints [N m], under that on the joints."""
        shape = self.q.shape
        taken, torque, limit = (
            np.zeros(shape),
            torque.reshape(shape),
            limit.reshape(shape),
        )
        for arm, motors in self._coupled:
            own = self._rotors[arm], self._viscous[arm], limit[arm]
            taken[arm] = motors(self.q[arm], self.dq[arm], torque[arm], *own)
        return taken.reshape(self.shape)

    def _again(self, torque: np.ndarray, limit: np.ndarray) -> None:
        """Steps of the arms, k of them, whose first guess was wrong; torque and limit as in ``advance``, (N, n)."""
        over = self._over if self._any_stuck else np.zeros_like(self._over)
        wrong = (self._way != self._direction) | over
        arms = np.flatnonzero(wrong.any(axis=1)).astype(np.int32)
        way = self._way[arms]
        guess = np.where(self._direction[arms] == way, way, 0.0)
        pushed = np.where(self._held[arms] > 0, 1.0, -1.0)
        guess = np.where(over[arms], pushed, guess)
        old, limit = self._old_dq[arms], limit[arms]
        work = torque[arms] - self._viscous[arms] * old
        known = (old, work, limit, self._dry[arms], self._effective[arms])
        left = np.arange(len(arms))
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
                guess[row] = self._search(int(arms[row]), work[row], limit[row])
            self._try(arms[left], guess[left], tuple(x[left] for x in known))
        self._keep(arms, guess)

    def _keep(self, arms: np.ndarray, direction: np.ndarray) -> None:
        """Note the directions, shape (k, n), with which some arms have made their step."""
        sticks = self._dry[arms] & (direction == 0)
        self._direction[arms], self._sticking[arms] = direction, sticks
        self._brake[arms] = HOLD * sticks / self._dt
        self._any_stuck = bool(self._sticking.any())
        self._signs = self._direction.tobytes()

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
        self._bodies.set_rotors(arms, inertia)
        self._bodies.step(work - direction * limit - braking, only=arms)
        velocity = np.where(stuck, 0.0, self.dq[arms])
        self.dq[arms] = velocity
        held = inertia * self._bodies.acceleration[arms] + braking
        over = stuck & (np.abs(held) > limit)
        way = sign(velocity * dry)
        kept = np.where(direction == way, direction, 0.0)
        following = np.where(over, np.where(held > 0, 1.0, -1.0), kept)
        wrong = ((way != direction) | over).any(axis=1)
        return np.flatnonzero(wrong), following

    def _take_back(self, arms: np.ndarray) -> None:
        """Put some arms back to where they were before the step."""
        self.q[arms], self.dq[arms] = self._old_q[arms], self._old_dq[arms]

    def _search(self, arm: int, out: np.ndarray, limit: np.ndarray) -> np.ndarray:
        """Directions of an arm's joints by a search that always ends, 0 if they stick, shape (n,).

        Args:
            arm: its number.
            out: torque less viscous friction [N m], shape (n,).
            limit: of dry friction [N m], shape (n,).
        """
        drive, forward = self._drives[arm], self._forward[arm]
        assert drive is not None
        if forward is None:
            forward = ForwardDynamics(drive.body, self._rotors[arm])
            self._forward[arm] = forward
        q, dq, dt = self._old_q[arm], self._old_dq[arm], self._dt
        forward.set_rotors(self._effective[arm])
        inertia = forward.mass_matrix(q)
        momentum = inertia @ dq + dt * (out - forward.bias(q, dq))
        self._friction[arm].solve(inertia, momentum, dt * limit)
        return np.where(self._dry[arm], self._friction[arm].direction, 0.0)
