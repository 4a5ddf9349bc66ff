"""A simulated arm with effects: an engine that moves the bodies, and the drive physics that moves the engine.

The torque of a residual network is taken off what it is commanded.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gapscope.arm.dynamics.plain_urdf import moving_links
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.residual.inputs import channels, channels_with
from gapscope.effects.residual.memory import Memory
from gapscope.effects.residual.model import ResidualNetwork
from gapscope.envs.drive.arm_drive import ArmDrive, Encoders, nominal_body
from gapscope.envs.drive.rigid_step import Native, Predicted
from gapscope.envs.engines import RotorEngine, make_engine

START_TRIALS = 50
"""Iterations of ``start`` for joints whose motor leads them."""


class SimulatedArm:
    """A simulated arm with effects, n joints in the arm's order, in a world of its own.

    Args:
        arm: the nominal arm; its armature and friction are simulated too.
        effects: what the simulated arm has beyond them.
        dt: time step [s] in which torque is held; stiff joints divide it further.
        engine: ``pybullet``, ``mujoco`` or ``dart``; by default PyBullet if it is installed, else MuJoCo.
        encoder_step: quantisation of the encoders [rad]; none by default.
        encoder_noise: standard deviation of white noise of the encoders [rad], a number or shape (n,).
        rng: source of the noise.
        load: known body on the last link, beyond the effects.
        nominal: the nominal rigid bodies with that load, if they are there already; see ``nominal_body``.

    Attributes:
        q: true joint positions [rad], shape (n,).
        dq: true joint velocities [rad/s], shape (n,).
        applied: motor torque that reached the joints in the last step, before friction [N m], shape (n,).
        time: since the start of the recording [s]; drift and external force go by it.
        nominal: nominal rigid bodies with the known load.
        body: the rigid bodies with its load, payload, link errors and tilt.
        parts: into how many parts a step is divided.

    Raises:
        InputError: an effect on a joint that does not exist, armature or friction that is negative in total, an arm
            whose inertia is not physical, a stiffness that the step cannot hold, or an engine that is not installed.
    """

    def __init__(
        self,
        arm: NominalArm,
        effects: tuple[AppliedEffect, ...] = (),
        dt: float = 1e-3,
        *,
        engine: str | None = None,
        encoder_step: float = 0.0,
        encoder_noise: np.ndarray | float = 0.0,
        rng: np.random.Generator | None = None,
        load: KnownLoad | None = None,
        nominal: RigidBody | None = None,
    ) -> None:
        self.nominal = nominal_body(arm, load) if nominal is None else nominal
        drive = ArmDrive(arm, effects, dt, self.nominal)
        self.arm, self.dt, self.body, self.parts = arm, dt, drive.body, drive.parts
        self._order, self._places = self.nominal.order, self.nominal.places
        self._ordered = bool((self._order == np.arange(arm.n_joints)).all())
        self._encoders = Encoders(drive.corrected, encoder_step)
        self._noise, self._rng = encoder_noise, rng if np.any(encoder_noise) else None
        self._loads, self._motors, self._path = drive.loads, drive.motors, drive.path
        self._friction, self._rigid, self._h = drive.friction, drive.rigid, drive.h
        self._two_mass, self._direct = not drive.rigid.all(), drive.direct
        self._set_engine(engine, drive)
        self._q, self._u = self._step.q, np.zeros(arm.n_joints)
        self._advance = (
            self._advance_two_mass if self._two_mass else self._advance_rigid
        )
        self.reset(np.zeros(arm.n_joints))

    def _set_engine(self, name: str | None, drive: ArmDrive) -> None:
        """Make the engine's world, and the steps of its joints."""
        links = moving_links(self.body)
        gravity = np.asarray(self.body.gravity)
        self._engine = make_engine(name, links, gravity, self._h)
        # motors of their own keep their rotor and their friction
        stepped = (
            self.body,
            np.where(self._rigid, drive.rotors, 0.0),
            self._friction.viscous * self._rigid,
            self._friction.dry & self._rigid,
            self._h,
        )
        self._step: Predicted | Native
        if isinstance(self._engine, RotorEngine):
            self._step = Native(self._engine, *stepped)
        else:
            limits = np.array([link.limits or (-np.inf, np.inf) for link in links]).T
            self._step = Predicted(self._engine, *stepped, limits)
        if drive.coupled.present:
            self._step.coupled = drive.coupled

    def __enter__(self) -> SimulatedArm:
        """Use as a context that closes the world at its end."""
        return self

    def __exit__(self, *exception: object) -> None:
        """Close the world."""
        self.close()

    def close(self) -> None:
        """Free the engine's world; a second call does nothing."""
        self._engine.close()

    def reset(
        self, q: np.ndarray, dq: np.ndarray | None = None, time: float = 0.0
    ) -> None:
        """Put the arm at true positions q [rad] with velocities dq [rad/s] (0 by default), and forget past torque.

        Motors of elastic joints are where they carry their link's weight. ``time`` [s] is that of the recording.
        """
        q = np.asarray(q, dtype=float)[self._order]
        dq = (
            np.zeros(len(q)) if dq is None else np.asarray(dq, dtype=float)[self._order]
        )
        self._start_time, self._count = time, 0
        self._engine.reset(q, dq)
        self._step.reset()
        if self._two_mass:
            self._motors.reset(q, dq, self._weight(q, dq, time))
        self._path.reset()
        self._drift()
        self._u = np.zeros(len(q))

    def start(
        self, reading: np.ndarray, dq: np.ndarray | None = None, time: float = 0.0
    ) -> None:
        """Put the arm where its encoders, but for rounding and noise, read ``reading`` [rad], shape (n,)."""
        seen = self._encoders.undone(np.asarray(reading, dtype=float))
        q = seen
        if self._two_mass and self._encoders.on_motor:
            still = np.zeros(len(q))
            # the motor leads its link by what the weight bends, which depends on where the link is
            for _ in range(START_TRIALS):
                load = self._weight(q[self._order], still, time)
                deflection = self._motors.deflection(load)[self._places]
                q = 0.5 * q + 0.5 * (seen - deflection)
        self.reset(q, dq, time)

    def _weight(self, q: np.ndarray, dq: np.ndarray, t: float) -> np.ndarray:
        """Torque [N m] that holds the links up at a constant velocity, shape (n,), kinematic order."""
        held = self.body.bias(q[self._places], dq[self._places])[self._order]
        if not self._loads.present:
            return held
        return held - self._loads(t, q, dq, held)

    @property
    def q(self) -> np.ndarray:
        """True joint positions [rad], shape (n,)."""
        return self._q.copy() if self._ordered else self._q[self._places]

    @property
    def dq(self) -> np.ndarray:
        """True joint velocities [rad/s], shape (n,)."""
        return self._step.dq.copy() if self._ordered else self._step.dq[self._places]

    @property
    def present_dq(self) -> np.ndarray:
        """``dq`` in kinematic order, not to be kept: the next step may change it in place."""
        return self._step.dq

    @property
    def motor_q(self) -> np.ndarray:
        """True positions of the motors [rad], joint side, shape (n,); those of rigid joints are the joints'."""
        return (self._motors.position if self._two_mass else self._q)[self._places]

    @property
    def applied(self) -> np.ndarray:
        """Motor torque that reached the joints in the last step, before friction [N m], shape (n,)."""
        return self._u[self._places]

    @property
    def time(self) -> float:
        """Time since the start of the recording [s]."""
        return self._start_time + self._count * self._h

    def encoders(self) -> np.ndarray:
        """Positions as the encoders read them [rad], shape (n,); each call draws its own noise."""
        noise = None
        if self._rng is not None:
            noise = self._noise * self._rng.standard_normal(len(self._q))
        if self._two_mass and self._encoders.on_motor:
            return self._encoders(self.motor_q, noise)
        # a reading is an array of its own, so that nothing is copied here
        joint = self._q if self._ordered else self._q[self._places]
        return self._encoders(joint, noise)

    def step(self, torque: np.ndarray, steps: int = 1) -> None:
        """Hold the commanded torque [N m], shape (n,), for ``steps`` time steps."""
        command = np.asarray(torque, dtype=float)
        if not self._ordered:
            command = command[self._order]
        count = steps * self.parts
        if not self._path.constant:
            self._hold_command(command, count)
            return
        self._u = self._path(command)
        if self._direct:
            self._engine.step(self._u, count)
            self._count += count
            self._step.read()
            return
        self._friction.load(self._u)
        if self._two_mass or self._loads.present:
            for _ in range(count):
                self._drift()
                self._advance()
                self._count += 1
        else:
            self._hold_torque(count)

    def _hold_torque(self, count: int) -> None:
        """Steps under a torque that does not change, of rigid joints on which nothing else acts."""
        friction, solver, torque = self._friction, self._step, self._u
        limit, advance = friction.limit, solver.advance
        drifting, every = friction.drifting, friction.every
        start = self._count
        for self._count in range(start, start + count):
            if drifting and not self._count % every:
                self._drift()
            advance(torque, limit(solver.dq))
        self._count = start + count

    def _hold_command(self, command: np.ndarray, count: int) -> None:
        """Steps under a command whose torque changes on its way to the joints."""
        for _ in range(count):
            self._drift()
            self._u = self._path(
                command, self._motors.position if self._two_mass else self._q
            )
            self._friction.load(self._u)
            self._advance()
            self._count += 1

    def _advance_rigid(self) -> None:
        """One step of rigid joints."""
        torque = (
            self._u + self._loads(self.time, self._q, self._step.dq, self._u)
            if self._loads.present
            else self._u
        )
        self._step.advance(torque, self._friction.limit(self._step.dq))

    def _advance_two_mass(self) -> None:
        """One step with separate motors: friction and rotors act on them, not on the links."""
        motors, rigid, torque = self._motors, self._rigid, self._u
        limit = self._friction.limit(motors.velocity)
        through = motors.torque(self._q, self._step.dq)
        on_links = np.where(rigid, torque, through)
        if self._loads.present:
            on_links += self._loads(self.time, self._q, self._step.dq, through)
        self._step.advance(on_links, limit * rigid)
        motors.step(torque, through, limit, self._friction.viscous, self._h)
        motors.follow(self._q, self._step.dq)

    def _drift(self) -> None:
        """Bring the drift of friction up to date if that is due."""
        friction = self._friction
        if friction.drifting and not self._count % friction.every:
            self._friction.drift(self.time)
            self._step.set_viscous(self._friction.viscous * self._rigid)


SPACING = 5
"""Steps between values on the reference."""


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
        load = replace(corrected, residual=None).predict(
            RigidBody(corrected.arm).carrying(payload), motion
        )
        self._planned = _on_lines(self._residual, motion, load)
        rows = slice(None, None, sub_steps)
        coarse = Motion(
            motion.t[rows], motion.q[rows], motion.dq[rows], motion.ddq[rows]
        )
        self._load, self._ddq = load[rows], coarse.ddq
        self._rate = coarse.rate
        self._on_reference = self._residual.torque(coarse, self._load)
        # what is not yet measured is never looked at
        self._seen = channels(coarse, self._load)
        self._memory = Memory(coarse.q[0])
        self._off = np.zeros(motion.q.shape[1])

    def see(self, number: int, q: np.ndarray, dq: np.ndarray) -> None:
        """Take note of position [rad] and velocity [rad/s], each (n,), before an action, numbered from 0."""
        load, ddq = self._load[number], self._ddq[number]
        if number == 0:
            self._memory = Memory(q)
        memory = self._memory.advance(q, load, 1.0 / self._rate)
        now = channels_with(memory[:, None], q[None], dq[None], ddq[None], load[None])
        self._seen[:, number] = now[:, 0]
        windows = self._residual.inputs.windows_of(
            self._seen, self._rate, np.array([number])
        )
        torque = self._residual.of_windows(windows).torque[0]
        self._off = torque - self._on_reference[number]

    def torque(self, step: int) -> np.ndarray:
        """The network's torque at a step of the simulation [N m], shape (n,)."""
        return np.asarray(self._planned[step] + self._off)


def _on_lines(
    residual: ResidualNetwork, motion: Motion, load: np.ndarray
) -> np.ndarray:
    """Residual torque at every step [N m], shape (N, n), on lines between every ``SPACING``-th step."""
    rows = np.append(np.arange(0, len(motion.t) - 1, SPACING), len(motion.t) - 1)
    said = residual.of_windows(residual.inputs.windows(motion, load, rows)).torque
    place = np.searchsorted(rows, np.arange(len(motion.t)), side="right").clip(
        1, len(rows) - 1
    )
    part = (
        (np.arange(len(motion.t)) - rows[place - 1]) / (rows[place] - rows[place - 1])
    )[:, None]
    return np.asarray((1 - part) * said[place - 1] + part * said[place])
