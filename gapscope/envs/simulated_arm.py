"""Simulated arms with effects: an engine that moves the bodies, and the drive physics that moves the engine.

The torque of a residual network is taken off what they are commanded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from gapscope.arm.control import Targets
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.arm.reading import interpolated
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.residual import Memory, channels, channels_with
from gapscope.envs.drive.arm_drive import ArmDrive, Encoders, nominal_body
from gapscope.envs.drive.laws import Friction, TorquePath
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


class SimulatedArm:
    """N simulated arms with effects and encoders, n joints in the arm's order, in a world of their own; one by default.

    Springs beside the joints, forces from outside and laws that a user entered are computed one arm after the other;
    all other effects over all arms at once. Each arm does what it does alone, bit by bit. Arrays hold the joints of all
    arms in a row, those of the first arm first, (N n,); what is handed out may be kept.

    Args:
        arm: the nominal arm; its armature and friction are simulated too.
        effects: what all arms have beyond it at first.
        dt: time step [s] in which torque is held; stiff joints divide it further.
        count: N; several need MuJoCo, and joints without motors of their own.
        engine: ``pybullet`` or ``mujoco``; by default PyBullet if it is installed, else MuJoCo.
        encoder_step: quantisation of the encoders [rad]; none by default.
        encoder_noise: standard deviation of white noise of the encoders [rad], a number or shape (n,).
        rng: source of that noise.
        nominal: its rigid bodies with a known load, as ``nominal_body`` gives them; those of ``arm`` alone by default.
        threads: on which MuJoCo steps several arms, see ``gapscope.envs.engines.mujoco.MuJoCoBodies``.

    Attributes:
        effects: of each arm.
        rngs: source of noise of each arm's encoders, or ``None``.
        motors: with positions and velocities of their own, of one arm; ``None`` if all joints are rigid.

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
        rng: np.random.Generator | None = None,
        nominal: RigidBody | None = None,
        threads: int = 0,
    ) -> None:
        self.arm, self.dt = arm, dt
        self.nominal = nominal_body(arm) if nominal is None else nominal
        self._shape = count, arm.n_joints
        n = arm.n_joints
        # a single arm may be on PyBullet, which knows neither
        self._several = {"count": count, "threads": threads} if count > 1 else {}
        self._engine, self._encoder_step = engine, encoder_step
        self._noise, self._noisy = encoder_noise, bool(np.any(encoder_noise))
        self.effects, self.rngs = [effects] * count, [rng] * count
        # places of the joints of all arms in the rows of the engine, and back
        rows = n * np.arange(count)[:, None]
        order, places = self.nominal.order, self.nominal.places
        self._order, self._places = (rows + order).ravel(), (rows + places).ravel()
        self._ordered = bool((order == np.arange(n)).all())
        self._build(self._drive(effects))
        for number in range(count):
            self.reset(np.zeros(n), number=number)

    def __enter__(self) -> SimulatedArm:
        """Use as a context that closes the world at its end."""
        return self

    def __exit__(self, *exception: object) -> None:
        """Close the world."""
        self.close()

    def close(self) -> None:
        """Free the engine's world; a second call does nothing."""
        self._bodies.close()

    def _drive(self, effects: tuple[AppliedEffect, ...]) -> ArmDrive:
        """The drives and bodies of an arm with effects; raises ``InputError`` if they cannot be simulated."""
        drive = ArmDrive(self.arm, effects, self.dt, self.nominal)
        flexible = not drive.rigid.all() or drive.parts > 1
        if self._several and (flexible or drive.coupled.present):
            names = ", ".join(applied.name for applied in effects)
            raise InputError(
                f"motors of their own, coupled motors and stiff springs are not stepped together ({names})",
                "give them when the environments are made, or take vectorization_mode='sync'",
                where="effects",
            )
        return drive

    def _build(self, drive: ArmDrive) -> None:
        """Have all arms stepped with the same drive."""
        count = len(self.effects)
        self._h, self._parts, self._rigid = drive.h, drive.parts, drive.rigid
        self._bodies = make_bodies(self._engine, drive.body, drive.h, **self._several)
        self._step = RigidStep(self._bodies, drive.h)
        # in kinematic order; they keep their places
        self._q, self._dq = self._step.q, self._step.dq
        # motor torque that reached the joints in the last step, before friction
        self._applied = np.zeros(self._q.size)
        self.motors = None if drive.rigid.all() else drive.motors
        self._motor_q = self._q if self.motors is None else self.motors.position
        # with the joints of all arms one after the other
        order = np.tile(self.nominal.order, count)
        self._friction = Friction(drive.corrected, order, drive.h)
        self._path = TorquePath(drive.corrected, order, drive.h)
        self._count, self._begun = 0, np.zeros(self._q.size, dtype=int)
        self._drifts_at = 0
        self._start = np.zeros(self._q.size)
        encoders = self._encoders_of(drive)
        self._encoders = [encoders] * count
        # in the arm's own order
        order = np.tile(np.arange(self._shape[1]), count)
        self._readings = Encoders(drive.corrected, order, self._encoder_step)
        self._seen = self._motor_q if encoders.on_motor else self._q
        self._drives = [drive] * count
        for number in range(count):
            self._enter(number, drive)

    def _encoders_of(self, drive: ArmDrive) -> Encoders:
        order = np.arange(self._shape[1])
        return Encoders(drive.corrected, order, self._encoder_step)

    def _enter(self, number: int, drive: ArmDrive) -> None:
        """Take over what follows from the effects of an arm."""
        self._step.put(number, drive)
        # one arm with friction takes all of them through the drive's step
        self._direct = all(drive.direct for drive in self._drives)
        self._loaded = [i for i, one in enumerate(self._drives) if one.loads.present]

    def put(self, effects: tuple[AppliedEffect, ...], number: int = 0) -> None:
        """Give an arm, numbered from 0, other effects; ``reset`` or ``start`` has to follow.

        Raises:
            InputError: they cannot be simulated, or not together with the other arms.
        """
        # the very same record, as at most resets: nothing is built anew
        if effects is self.effects[number]:
            return
        drive = self._drive(effects)
        if not self._several:
            # made first: if that fails, the one before still stands
            before = self._bodies
            self._build(drive)
            before.close()
        else:
            # bodies that were and stay the nominal ones need not be written again
            if drive.altered or self._drives[number].altered:
                self._bodies.set_bodies(number, drive.body)
            self._friction.put(number, drive.friction)
            self._path.put(number, drive.path)
            self._drives[number] = drive
            self._enter(number, drive)
            self._encoders[number] = self._encoders_of(drive)
            self._readings.put(number, self._encoders[number])
        self.effects[number] = effects

    def become(self, effects: tuple[AppliedEffect, ...], time: float) -> None:
        """Have other effects from a time [s] on: position and velocity of the arm go on, states of effects do not."""
        # the true state, not what the encoders make of it
        q, dq = self.q, self.dq
        self.put(effects)
        self.reset(q, dq, time)

    def reset(
        self,
        q: np.ndarray,
        dq: np.ndarray | float = 0.0,
        time: float = 0.0,
        number: int = 0,
    ) -> None:
        """Put an arm at true positions q [rad] with velocities dq [rad/s], each (n,), and forget its past.

        Motors of elastic joints are where they carry their link's weight. ``time`` [s] is that of the recording.
        """
        n, friction, order = len(q), self._friction, self.nominal.order
        q, dq = q[order], (np.zeros(n) + dq)[order]
        rows = slice(number * n, (number + 1) * n)
        # arms begin at different steps of one count
        self._start[rows], self._begun[rows] = time, self._count
        # whatever was due, drift is looked at in the next step
        self._drifts_at = self._count
        self._bodies.reset(number, q, dq)
        if friction.drifting:
            own = np.zeros(self._q.size, dtype=bool)
            own[rows] = True
            friction.drift(time, where=own)
        self._step.reset(number, self._viscous())
        if self.motors is not None:
            self.motors.reset(q, dq, self._weight(number, q, dq, time))
        self._path.reset(rows)
        # the torque held before may be the commander's own
        self._applied = self._applied.copy()
        self._applied[rows] = 0.0

    def start(
        self,
        reading: np.ndarray,
        dq: np.ndarray | float = 0.0,
        time: float = 0.0,
        number: int = 0,
    ) -> None:
        """Put an arm where its encoders, but for rounding and noise, read ``reading`` [rad], with dq [rad/s], (n,)."""
        encoders, order = self._encoders[number], self.nominal.order
        q = seen = encoders.undone(reading)
        if self.motors is not None and encoders.on_motor:
            still = np.zeros(len(q))
            # the motor leads its link by what the weight bends, which depends on where the link is
            for _ in range(START_TRIALS):
                load = self._weight(number, q[order], still, time)
                deflection = self.motors.deflection(load)[self.nominal.places]
                # half of the way: the whole may swing where the weight changes
                q = 0.5 * q + 0.5 * (seen - deflection)
        self.reset(q, dq, time, number)

    def _weight(
        self, number: int, q: np.ndarray, dq: np.ndarray, time: float
    ) -> np.ndarray:
        """Torque [N m] that holds the links of an arm up at a constant velocity, shape (n,), in kinematic order."""
        drive, places = self._drives[number], self.nominal.places
        held = drive.body.bias(q[places], dq[places])[self.nominal.order]
        if not drive.loads.present:
            return held
        # what a spring or a force carries, the motors need not
        return held - drive.loads(time, q, dq, held)

    def _in_order(self, values: np.ndarray) -> np.ndarray:
        """A copy of values in kinematic order in that of the arm, (N n,)."""
        return values.copy() if self._ordered else values[self._places]

    @property
    def body(self) -> RigidBody:
        """The rigid bodies of the first arm with its load, payload, link errors and tilt."""
        return self._drives[0].body

    @property
    def q(self) -> np.ndarray:
        """True joint positions [rad], shape (N n,)."""
        return self._in_order(self._q)

    @property
    def dq(self) -> np.ndarray:
        """True joint velocities [rad/s], shape (N n,)."""
        return self._in_order(self._dq)

    @property
    def speed2(self) -> float:
        """Sum of the squares of all joint velocities [rad^2/s^2]: not a number if an arm has diverged."""
        return float(self._dq.dot(self._dq))

    @property
    def motor_q(self) -> np.ndarray:
        """True positions of the motors [rad], joint side, shape (N n,); those of rigid joints are the joints'."""
        return self._in_order(self._motor_q)

    @property
    def applied(self) -> np.ndarray:
        """Motor torque that reached the joints in the last step, before friction [N m], shape (N n,)."""
        return self._in_order(self._applied)

    def encoders(self, number: int | None = None) -> np.ndarray:
        """Positions as the encoders read them [rad], (N n,) or, of one arm, (n,); each call draws its own noise."""
        seen, noise = self._seen, None
        if self._noisy:
            arms = range(self._shape[0]) if number is None else (number,)
            noise = np.concatenate([self._drawn(arm) for arm in arms])
        # a reading is an array of its own, so that nothing is copied here
        seen = seen if self._ordered else seen[self._places]
        if number is None:
            return self._readings(seen, noise)
        return self._encoders[number](seen.reshape(self._shape)[number], noise)

    def _drawn(self, number: int) -> np.ndarray:
        """Noise of an arm [rad], shape (n,)."""
        rng, n = self.rngs[number], self._shape[1]
        return np.zeros(n) if rng is None else self._noise * rng.standard_normal(n)

    def step(self, torque: np.ndarray, steps: int = 1) -> None:
        """Hold the commanded torque [N m], shape (N n,), for so many time steps."""
        # a copy: it is held, whatever becomes of the array
        torque = torque.copy() if self._ordered else torque[self._order]
        path, friction = self._path, self._friction
        count = steps * self._parts
        # a held command gives one torque for all steps
        if path.constant:
            self._applied = path(torque)
            # the engine makes all steps on its own
            if self._direct:
                self._bodies.run(self._applied, count)
                self._count += count
                return
            # friction by load follows the torque that arrives
            friction.load(self._applied)
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
        velocity = self._dq if motors is None else motors.velocity
        self._applied = path(command, self._motor_q, velocity)
        if not friction.drifting:
            friction.load(self._applied)
            return
        # a torque that is held was taken over before friction drifted on
        if first:
            friction.load(self._applied, where=~path.changing)
        self._drift()
        friction.load(self._applied, where=path.changing)

    def _advance(self) -> None:
        """One step of all arms."""
        torque, motors = self._applied, self.motors
        if motors is not None:
            # friction and rotors act on the motors, not on the links
            limit = self._friction.limit(motors.velocity)
            through = motors.torque(self._q, self._dq)
            on_links = np.where(self._rigid, torque, through)
            if self._loaded:
                on_links += self._load(0, on_links)
            self._step.advance(on_links, limit * self._rigid)
            motors.step(torque, through, limit, self._friction.viscous, self._h)
            motors.follow(self._q, self._dq)
            return
        if self._loaded:
            # what has arrived is told without what acts beside it
            torque = torque.copy()
            for number in self._loaded:
                rows = slice(number * self._shape[1], (number + 1) * self._shape[1])
                torque[rows] += self._load(number, self._applied[rows])
        self._step.advance(torque, self._friction.limit(self._dq))

    def _load(self, number: int, through: np.ndarray) -> np.ndarray:
        """What acts on the links of an arm besides gravity and its drives [N m], shape (n,)."""
        place = number * self._shape[1]
        time = self._start[place] + (self._count - self._begun[place]) * self._h
        q, dq = (x.reshape(self._shape)[number].copy() for x in (self._q, self._dq))
        return self._drives[number].loads(float(time), q, dq, through)

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
        said = self._residual.of_windows(windows)
        self._planned = interpolated(np.arange(last + 1), spaced, said)
        rows = slice(None, None, sub_steps)
        coarse = motion.part(rows)
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
        torque = self._residual.of_windows(windows)[0]
        self._off = torque - self._on_reference[number]

    def torque(self, step: int) -> np.ndarray:
        """The network's torque at a step of the simulation [N m], shape (n,)."""
        return np.asarray(self._planned[step] + self._off)
