"""Simulated arms with effects: an engine that moves the bodies, and the drive physics that moves the engine.

One arm is one of N arms. The torque of a residual network is taken off what it is commanded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from gapscope.arm.control import Targets
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.residual import Memory, channels, channels_with
from gapscope.envs.drive.arm_drive import ArmDrive, Encoders, nominal_body
from gapscope.envs.drive.rigid_step import RigidStep
from gapscope.envs.engines import make_bodies

START_TRIALS = 50
"""Iterations of ``start`` for joints whose motor leads them."""
SPACING = 5
"""Steps between values on the reference."""
FASTEST_OBSERVED = 50.0
"""Bound of observed velocities, beyond those of an arm [rad/s]."""


def diverged(dq: np.ndarray) -> bool:
    """Whether velocities [rad/s], shape (n,), are beyond those of an arm: above ``FASTEST_OBSERVED``, or not finite."""
    if dq.dot(dq) <= FASTEST_OBSERVED**2:  # then no joint can be
        return False
    return not np.abs(dq).max() <= FASTEST_OBSERVED


def fastest(dq: np.ndarray) -> int:
    """Index of the fastest joint; dq [rad/s], shape (n,), may hold what is no number, which counts as fastest."""
    return int(np.argmax(np.where(np.isfinite(dq), np.abs(dq), np.inf)))


class ArmsTogether:
    """N simulated arms with effects that are stepped together, n joints in kinematic order.

    Springs beside the joints, forces from outside and laws that a user entered are computed one arm after the other;
    all other effects over all arms at once. Each arm does what it does alone, bit by bit. Arrays hold the joints of all
    arms in a row, those of the first arm first, (N n,).

    Args:
        first: bodies and drives of all arms at first. Of several arms none has a motor of its own at a joint.
        count: N; on PyBullet 1.
        threads: on which MuJoCo steps them, see ``gapscope.envs.engines.mujoco.MuJoCoBodies``.
        engine: ``pybullet`` or ``mujoco``; by default PyBullet if it is installed, else MuJoCo.

    Attributes:
        q, dq: true positions [rad] and velocities [rad/s], shape (N n,); they keep their places.
        applied: motor torque that reached the joints in the last step, before friction [N m], shape (N n,); not to be
            changed.
        motors: with positions and velocities of their own, of one arm; ``None`` if all joints are rigid.
        motor_q: true positions of the motors [rad], joint side, shape (N n,), which keep their places; ``q`` itself if
            all joints are rigid.

    Raises:
        InputError: an engine that is not installed.
    """

    def __init__(
        self,
        first: ArmDrive,
        count: int = 1,
        threads: int = 0,
        engine: str | None = "mujoco",
    ) -> None:
        self._h, self._parts = first.h, first.parts
        # a single arm may be on PyBullet, which knows neither
        several = {"count": count, "threads": threads} if count > 1 else {}
        self._bodies = make_bodies(engine, first.body, first.h, **several)
        self._step = RigidStep(self._bodies, self._h)
        self.q, self.dq = self._step.q, self._step.dq
        self.applied = np.zeros(self.q.size)
        self._shape = count, len(first.rigid)
        self.motors = None if first.rigid.all() else first.motors
        self.motor_q = self.q if self.motors is None else self.motors.position
        self._rigid = first.rigid
        self._drives = [first] * count
        self._friction = first.friction.beside(count)
        self._path = first.path.beside(count)
        self._count, self._begun = 0, np.zeros(self.q.size, dtype=int)
        self._drifts_at = 0
        self._start = np.zeros(self.q.size)
        for number in range(count):
            self._enter(number, first)

    def put(self, number: int, drive: ArmDrive) -> None:
        """Give an arm, numbered from 0, other effects; ``reset`` has to follow."""
        # bodies that were and stay the nominal ones need not be written again
        if drive.altered or self._drives[number].altered:
            self._bodies.set_bodies(number, drive.body)
        self._friction.put(number, drive.friction)
        self._path.put(number, drive.path)
        self._drives[number] = drive
        self._enter(number, drive)

    def _enter(self, number: int, drive: ArmDrive) -> None:
        """Take over what follows from the effects of an arm."""
        self._step.put(number, drive)
        # one arm with friction takes all of them through the drive's step
        self._direct = all(drive.direct for drive in self._drives)
        self._loaded = [i for i, one in enumerate(self._drives) if one.loads.present]

    def reset(
        self, number: int, q: np.ndarray, dq: np.ndarray, time: float = 0.0
    ) -> None:
        """Put an arm at true positions q [rad] with velocities dq [rad/s], each (n,), and forget its past.

        Motors of elastic joints are where they carry their link's weight. ``time`` [s] is that of the recording.
        """
        n, friction = len(q), self._friction
        rows = slice(number * n, (number + 1) * n)
        # arms begin at different steps of one count
        self._start[rows], self._begun[rows] = time, self._count
        # whatever was due, drift is looked at in the next step
        self._drifts_at = self._count
        self._bodies.reset(number, q, dq)
        if friction.drifting:
            own = np.zeros(self.q.size, dtype=bool)
            own[rows] = True
            friction.drift(time, where=own)
        self._step.reset(number, self._viscous())
        if self.motors is not None:
            self.motors.reset(q, dq, self.weight(number, q, dq, time))
        self._path.reset(rows)
        # the torque held before may be the commander's own
        self.applied = self.applied.copy()
        self.applied[rows] = 0.0

    def start(
        self,
        number: int,
        encoders: Encoders,
        reading: np.ndarray,
        dq: np.ndarray,
        time: float = 0.0,
    ) -> None:
        """Put an arm where its encoders, but for rounding and noise, read ``reading`` [rad], with dq [rad/s].

        Both are of shape (n,), in the order of the data sheet.
        """
        body, seen = self._drives[number].body, encoders.undone(reading)
        q = seen
        if self.motors is not None and encoders.on_motor:
            still = np.zeros(len(q))
            # the motor leads its link by what the weight bends, which depends on where the link is
            for _ in range(START_TRIALS):
                load = self.weight(number, q[body.order], still, time)
                deflection = self.motors.deflection(load)[body.places]
                # half of the way: the whole may swing where the weight changes
                q = 0.5 * q + 0.5 * (seen - deflection)
        self.reset(number, q[body.order], dq[body.order], time)

    def weight(
        self, number: int, q: np.ndarray, dq: np.ndarray, time: float
    ) -> np.ndarray:
        """Torque [N m] that holds the links of an arm up at a constant velocity, shape (n,)."""
        drive = self._drives[number]
        places, order = drive.body.places, drive.body.order
        held = drive.body.bias(q[places], dq[places])[order]
        if not drive.loads.present:
            return held
        # what a spring or a force carries, the motors need not
        return held - drive.loads(time, q, dq, held)

    @property
    def time(self) -> np.ndarray:
        """Time since the start of the recording [s], shape (N n,); drift and external force go by it."""
        return self._start + (self._count - self._begun) * self._h

    def hold(self, torque: np.ndarray, steps: int = 1) -> None:
        """Hold the commanded torque [N m], shape (N n,), which is not to be changed then, for so many time steps."""
        path, friction = self._path, self._friction
        count = steps * self._parts
        # a held command gives one torque for all steps
        if path.constant:
            self.applied = path(torque)
            # the engine makes all steps on its own
            if self._direct:
                self._bodies.run(self.applied, count)
                self._count += count
                return
            # friction by load follows the torque that arrives
            friction.load(self.applied)
        for step in range(count):
            if not path.constant:
                self._send(torque, first=step == 0)
            elif friction.drifting:
                self._drift()
            self._advance()
            self._count += 1

    def _send(self, command: np.ndarray, first: bool) -> None:
        """Torque of a step of which some changes on its way to the joints; ``first`` of those of a command."""
        path, friction, motors = self._path, self._friction, self.motors
        position = self.q if motors is None else motors.position
        velocity = self.dq if motors is None else motors.velocity
        self.applied = path(command, position, velocity)
        if not friction.drifting:
            friction.load(self.applied)
            return
        # a torque that is held was taken over before friction drifted on
        if first:
            friction.load(self.applied, where=~path.changing)
        self._drift()
        friction.load(self.applied, where=path.changing)

    def _advance(self) -> None:
        """One step of all arms."""
        torque, motors = self.applied, self.motors
        if motors is not None:
            # friction and rotors act on the motors, not on the links
            limit = self._friction.limit(motors.velocity)
            through = motors.torque(self.q, self.dq)
            on_links = np.where(self._rigid, torque, through)
            if self._loaded:
                on_links += self._load(0, through)
            self._step.advance(on_links, limit * self._rigid)
            motors.step(torque, through, limit, self._friction.viscous, self._h)
            motors.follow(self.q, self.dq)
            return
        if self._loaded:
            # what has arrived is told without what acts beside it
            torque = torque.copy()
            for number in self._loaded:
                n = self._shape[1]
                rows = slice(number * n, (number + 1) * n)
                torque[rows] += self._load(number, self.applied[rows])
        self._step.advance(torque, self._friction.limit(self.dq))

    def _load(self, number: int, through: np.ndarray) -> np.ndarray:
        """What acts on the links of an arm besides gravity and its drives [N m], shape (n,)."""
        time = float(self.time[number * self._shape[1]])
        q, dq = (x.reshape(self._shape)[number].copy() for x in (self.q, self.dq))
        return self._drives[number].loads(time, q, dq, through)

    def _viscous(self) -> np.ndarray:
        """Viscous friction of the joints without a motor of their own [N m s/rad], shape (N n,)."""
        viscous = self._friction.viscous
        return viscous if self.motors is None else viscous * self._rigid

    def _drift(self) -> None:
        """Bring the drift of friction up to date in the arms in which that is due."""
        if self._count < self._drifts_at:
            return
        steps, every = self._count - self._begun, self._friction.every
        since = steps % every
        # when the first of the arms is due again
        self._drifts_at = self._count + every - int(since.max())
        self._friction.drift(self._start + steps * self._h, where=since == 0)
        self._step.set_viscous(self._viscous())

    def close(self) -> None:
        """Free the engine's world; a second call does nothing."""
        self._bodies.close()


class SimulatedArms:
    """N simulated arms with effects and encoders, n joints in the arm's order; one arm is one of N.

    Each arm does what it does alone, bit by bit. Arrays that are handed in and out at every step hold the joints of all
    arms in a row, (N n,).

    Args:
        arm: the nominal arm; its armature and friction are simulated too.
        effects: what all simulated arms have beyond them at first.
        dt: time step [s] in which torque is held; stiff joints divide it further.
        count: N.
        engine: ``pybullet`` or ``mujoco``; by default PyBullet if it is installed, else MuJoCo.
        encoder_step: quantisation of the encoders [rad]; none by default.
        encoder_noise: standard deviation of white noise of the encoders [rad], a number or shape (n,).
        load: known body on the last link, beyond the effects.
        together: whether several arms are stepped by one simulator, which needs MuJoCo and rigid joints; otherwise each
            has one of its own.
        threads: on which MuJoCo steps them, see ``gapscope.envs.engines.mujoco``.

    Attributes:
        nominal: nominal rigid bodies with the known load.
        effects, drives: of each arm.
        simulators: what steps them, joints in kinematic order: one for all arms, or one for each.
        q, dq, motor_q: as of ``ArmsTogether``, of all arms; not to be kept.

    Raises:
        InputError: an effect on a joint that does not exist, armature or friction that is negative in total, an arm
            whose inertia is not physical, a stiffness that the step cannot hold, an engine that is not installed, or
            arms that cannot be stepped together.
    """

    def __init__(
        self,
        arm: NominalArm,
        effects: tuple[AppliedEffect, ...] = (),
        dt: float = 1e-3,
        count: int = 1,
        *,
        engine: str | None = None,
        encoder_step: float = 0.0,
        encoder_noise: np.ndarray | float = 0.0,
        load: KnownLoad | None = None,
        together: bool = False,
        threads: int = 0,
    ) -> None:
        self.nominal = nominal_body(arm, load)
        self.arm, self.dt = arm, dt
        self._shape = count, arm.n_joints
        self._engine, self._together = engine, together
        self.effects = [effects] * count
        own = 1 if together else count
        # a drive has a state, as of its motors: no two simulators share one
        drives = [self._drive(effects) for _ in range(own)]
        each = count // own, threads, engine
        self.simulators = [ArmsTogether(drive, *each) for drive in drives]
        self._single = own == 1
        self.drives = drives * each[0]
        first = arm.n_joints * np.arange(count)[:, None]
        # places of the joints of all arms in the rows of the engine, and back
        order, places = self.nominal.order, self.nominal.places
        self._order, self._places = (first + order).ravel(), (first + places).ravel()
        self._ordered = bool((order == np.arange(arm.n_joints)).all())
        self._encoder_step = encoder_step
        encoders = Encoders(drives[0].corrected, encoder_step)
        self._encoders, self._readings = [encoders] * count, encoders.beside(count)
        self._on_motor = encoders.on_motor
        self._noise, self._noisy = encoder_noise, False
        self._rngs: list[np.random.Generator | None] = [None] * count
        self._take()

    def _drive(self, effects: tuple[AppliedEffect, ...]) -> ArmDrive:
        """The drives and bodies of an arm with effects; raises ``InputError`` if they cannot be simulated."""
        drive = ArmDrive(self.arm, effects, self.dt, self.nominal)
        flexible = not drive.rigid.all() or drive.parts > 1
        if self._together and (flexible or drive.coupled.present):
            names = ", ".join(applied.name for applied in effects)
            raise InputError(
                f"motors of their own, coupled motors and stiff springs are not stepped together ({names})",
                "give them when the environments are made, or take vectorization_mode='sync'",
                where="effects",
            )
        return drive

    def _of(self, number: int) -> tuple[ArmsTogether, int]:
        """The simulator of an arm, and the arm's number in it."""
        if self._single:
            return self.simulators[0], number
        return self.simulators[number], 0

    def put(self, number: int, effects: tuple[AppliedEffect, ...]) -> None:
        """Give an arm, numbered from 0, other effects; ``reset`` or ``start`` has to follow.

        Raises:
            InputError: they cannot be simulated, or not together with the other arms.
        """
        # the very same record, as at most resets: nothing is built anew
        if effects is self.effects[number]:
            return
        drive = self._drive(effects)
        if self._together:
            self.simulators[0].put(number, drive)
        else:
            # made first: if that fails, the one before still stands
            made = ArmsTogether(drive, engine=self._engine)
            self.simulators[number].close()
            self.simulators[number] = made
        self.drives[number], self.effects[number] = drive, effects
        self._encoders[number] = Encoders(drive.corrected, self._encoder_step)
        self._readings.put(number, self._encoders[number])
        self._take()

    def draw_noise_from(self, number: int, rng: np.random.Generator | None) -> None:
        """Give the encoders of an arm, numbered from 0, a source of noise."""
        # without noise nothing is drawn at a reading
        self._rngs[number] = rng if np.any(self._noise) else None
        self._noisy = any(one is not None for one in self._rngs)

    def reset(
        self, number: int, q: np.ndarray, dq: np.ndarray, time: float = 0.0
    ) -> None:
        """Put an arm at true positions q [rad] with velocities dq [rad/s], each (n,), and forget its past.

        Motors of elastic joints are where they carry their link's weight. ``time`` [s] is that of the recording.
        """
        simulator, place = self._of(number)
        order = self.nominal.order
        simulator.reset(place, q[order], dq[order], time)
        self._take()

    def start(
        self, number: int, reading: np.ndarray, dq: np.ndarray, time: float = 0.0
    ) -> None:
        """Put an arm where its encoders, but for rounding and noise, read ``reading`` [rad], with dq [rad/s], (n,)."""
        simulator, place = self._of(number)
        simulator.start(place, self._encoders[number], reading, dq, time)
        self._take()

    def hold(self, torque: np.ndarray, steps: int = 1) -> None:
        """Hold the commanded torque [N m], (N n,), which is not to be changed then, for so many time steps."""
        inside = torque if self._ordered else torque[self._order]
        if self._single:
            self.simulators[0].hold(inside, steps)
            return
        rows = inside.reshape(len(self.simulators), -1)
        for simulator, row in zip(self.simulators, rows, strict=True):
            simulator.hold(row, steps)
        # put together from several simulators, they are other arrays after each step
        self._take()

    def inside(self, name: str) -> np.ndarray:
        """An attribute of ``ArmsTogether`` for all arms, (N n,), joints in kinematic order; not to be kept."""
        own: list[np.ndarray] = [getattr(one, name) for one in self.simulators]
        return own[0] if len(own) == 1 else np.concatenate(own)

    def _take(self) -> None:
        """Take what is asked for at every step; arrays of a single simulator keep their places."""
        self.q, self.dq, self.motor_q = map(self.inside, ("q", "dq", "motor_q"))

    def state(self, name: str) -> np.ndarray:
        """A copy of the same by arms and in the arm's order, (N, n)."""
        values = self.inside(name)
        own = values.copy() if self._ordered else values[self._places]
        return own.reshape(self._shape)

    def read(self) -> np.ndarray:
        """Positions as the encoders read them [rad], shape (N n,); each call draws its own noise."""
        noise = None
        if self._noisy:
            noise = np.concatenate([self._drawn(arm) for arm in range(self._shape[0])])
        # a reading is an array of its own, so that nothing is copied here
        seen = self.motor_q if self._on_motor else self.q
        return self._readings(seen if self._ordered else seen[self._places], noise)

    def read_one(self, number: int) -> np.ndarray:
        """Positions as the encoders of one arm read them [rad], shape (n,)."""
        seen = self.state("motor_q" if self._on_motor else "q")
        noise = None if self._rngs[number] is None else self._drawn(number)
        return self._encoders[number](seen[number], noise)

    def _drawn(self, number: int) -> np.ndarray:
        """Noise of an arm [rad], shape (n,)."""
        rng, n = self._rngs[number], self._shape[1]
        return np.zeros(n) if rng is None else self._noise * rng.standard_normal(n)

    def close(self) -> None:
        """Free the engines' worlds; a second call does nothing."""
        for simulator in self.simulators:
            simulator.close()


class SimulatedArm:
    """One simulated arm with effects, n joints in the arm's order, in a world of its own.

    Args:
        arm, effects, dt, options: as of ``SimulatedArms``.
        rng: source of the encoders' noise.

    Attributes:
        body: the rigid bodies with its load, payload, link errors and tilt.
        parts: into how many parts a step is divided.

    Raises:
        InputError: as ``SimulatedArms``.
    """

    def __init__(
        self,
        arm: NominalArm,
        effects: tuple[AppliedEffect, ...] = (),
        dt: float = 1e-3,
        *,
        rng: np.random.Generator | None = None,
        **options: Any,
    ) -> None:
        self.arm, self.dt = arm, dt
        self._arms = SimulatedArms(arm, effects, dt, **options)
        self._arms.draw_noise_from(0, rng)
        drive = self._arms.drives[0]
        self.body, self.parts = drive.body, drive.parts
        self.reset(np.zeros(arm.n_joints))

    def __enter__(self) -> SimulatedArm:
        """Use as a context that closes the world at its end."""
        return self

    def __exit__(self, *exception: object) -> None:
        """Close the world."""
        self.close()

    def close(self) -> None:
        """Free the engine's world; a second call does nothing."""
        self._arms.close()

    def reset(
        self, q: np.ndarray, dq: np.ndarray | float = 0.0, time: float = 0.0
    ) -> None:
        """Put the arm at true positions q [rad] with velocities dq [rad/s], and forget past torque.

        Motors of elastic joints are where they carry their link's weight. ``time`` [s] is that of the recording.
        """
        true = np.asarray(q, dtype=float)
        self._arms.reset(0, true, np.zeros_like(true) + dq, time)

    @property
    def effects(self) -> tuple[AppliedEffect, ...]:
        """What it has beyond the nominal arm."""
        return self._arms.effects[0]

    def become(self, effects: tuple[AppliedEffect, ...], time: float) -> None:
        """Have other effects from a time [s] on: position and velocity continue, states of effects are forgotten."""
        # the true state, not what the encoders make of it
        q, dq = self.q, self.dq
        self._arms.put(0, effects)
        self.reset(q, dq, time)

    def start(
        self, reading: np.ndarray, dq: np.ndarray | float = 0.0, time: float = 0.0
    ) -> None:
        """Put the arm where its encoders, but for rounding and noise, read ``reading`` [rad], shape (n,)."""
        seen = np.asarray(reading, dtype=float)
        self._arms.start(0, seen, np.zeros_like(seen) + dq, time)

    @property
    def q(self) -> np.ndarray:
        """True joint positions [rad], shape (n,)."""
        return self._arms.state("q")[0]

    @property
    def dq(self) -> np.ndarray:
        """True joint velocities [rad/s], shape (n,)."""
        return self._arms.state("dq")[0]

    @property
    def motor_q(self) -> np.ndarray:
        """True positions of the motors [rad], joint side, shape (n,); those of rigid joints are the joints'."""
        return self._arms.state("motor_q")[0]

    @property
    def applied(self) -> np.ndarray:
        """Motor torque that reached the joints in the last step, before friction [N m], shape (n,)."""
        return self._arms.state("applied")[0]

    @property
    def time(self) -> float:
        """Time since the start of the recording [s]; drift and external force go by it."""
        return float(self._arms.inside("time")[0])

    def encoders(self) -> np.ndarray:
        """Positions as the encoders read them [rad], shape (n,); each call draws its own noise."""
        return self._arms.read()

    def step(self, torque: np.ndarray, steps: int = 1) -> None:
        """Hold the commanded torque [N m], shape (n,), for ``steps`` time steps."""
        # a copy: it is held, whatever becomes of the array
        self._arms.hold(np.array(torque, dtype=float), steps)


def closed_loop(
    simulated: SimulatedArm,
    targets: Targets,
    control: Callable[[Targets, np.ndarray, np.ndarray], np.ndarray],
    velocity: Callable[[Targets, np.ndarray], np.ndarray],
    steps: int = 1,
    network: NetworkTorque | None = None,
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Run an arm under a controller: at each tick what the encoders read, the velocity, and the torque commanded.

    Each tick is given when its torque has been held until the next one. All are of shape (n,) [rad], [rad/s], [N m].

    Args:
        simulated: the arm, at its start.
        targets: what it is to follow at each tick.
        control: torque by the target, position and velocity.
        velocity: by the target and the position.
        steps: of the simulation per tick.
        network: what a residual network takes off the torque, or ``None``.
    """
    # rows of all series side by side: indexing each series at each tick takes longer than the law
    followed = map(Targets._make, zip(*targets, strict=True))
    for number, now in enumerate(followed):
        q = simulated.encoders()
        dq = velocity(now, q)
        # the controller knows nothing of the network: its torque is given as it is
        torque = felt = control(now, q, dq)
        if network is not None:
            network.see(number, q, dq)
            felt = torque - network.torque(number)
        simulated.step(felt, steps)
        yield q, dq, torque


class NetworkTorque:
    """What a residual network says of an arm that moves near its reference, n joints.

    The network adds to the torque that must be commanded, so its torque is taken off what is commanded before it
    reaches the arm: r(t) = R(reference)(t) + R(measured) - R(reference). The first is computed every ``SPACING``
    steps with lines between, the difference at every action and held. The measured motion is that of the encoders at
    the actions before, with the acceleration of the reference and the load that the arm without network would need.

    Args:
        corrected: the arm with its network, and with the effects of this episode.
        motion: the reference at every step of the simulation.
        sub_steps: steps per action.
        payload: known body on the last link, or ``None``.
    """

    def __init__(
        self,
        corrected: CorrectedArm,
        motion: Motion,
        sub_steps: int,
        payload: KnownLoad | None = None,
    ) -> None:
        assert corrected.residual is not None
        self._residual = corrected.residual
        # what the arm needs without its network, which is told to the network
        load = replace(corrected, residual=None).predict(
            RigidBody(corrected.arm).carrying(payload), motion
        )
        last = len(motion.t) - 1
        # the last step is among them, so that the lines end there
        spaced = np.append(np.arange(0, last, SPACING), last)
        windows = self._residual.inputs.windows(motion, load, spaced)
        said = self._residual.of_windows(windows).torque
        self._planned = between(spaced, said, np.arange(last + 1))
        rows = slice(None, None, sub_steps)
        coarse = Motion(
            motion.t[rows], motion.q[rows], motion.dq[rows], motion.ddq[rows]
        )
        self._load, self._ddq = load[rows], coarse.ddq
        self._rate = coarse.rate
        # at the same coarse samples as the measured motion: their error cancels
        self._on_reference = self._residual.torque(coarse, self._load)
        # what is not yet measured is never looked at
        self._seen = channels(coarse, self._load)
        self._memory = Memory(coarse.q[0])
        self._off = np.zeros(motion.q.shape[1])

    def see(self, number: int, q: np.ndarray, dq: np.ndarray) -> None:
        """Take note of position [rad] and velocity [rad/s], each (n,), before an action, numbered from 0."""
        load, ddq = self._load[number], self._ddq[number]
        # the arm begins where it was measured, not where the reference begins
        if number == 0:
            self._memory = Memory(q)
        memory = self._memory.advance(q, load, 1.0 / self._rate)
        now = channels_with(memory[:, None], q[None], dq[None], ddq[None], load[None])
        # windows that end here hold what was measured at the actions before
        self._seen[:, number] = now[:, 0]
        windows = self._residual.inputs.windows_of(
            self._seen, self._rate, np.array([number])
        )
        torque = self._residual.of_windows(windows).torque[0]
        self._off = torque - self._on_reference[number]

    def torque(self, step: int) -> np.ndarray:
        """The network's torque at a step of the simulation [N m], shape (n,)."""
        return np.asarray(self._planned[step] + self._off)


def between(t: np.ndarray, series: np.ndarray, at: np.ndarray) -> np.ndarray:
    """A series (K, n) at other times (N,), linear between its samples and constant beyond them, (N, n)."""
    return np.stack([np.interp(at, t, column) for column in series.T], axis=1)
