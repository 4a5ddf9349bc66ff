"""The plants of many environments: ``gapscope.envs.plant.ControlledArm`` over N arms at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.actions import Gains, scaled
from gapscope.envs.course import Course
from gapscope.envs.drive.arm_drive import ArmDrive
from gapscope.envs.drive.encoders import Encoders
from gapscope.envs.episode import Setup
from gapscope.envs.observation import FASTEST_OBSERVED
from gapscope.envs.plant import sensor_chunk
from gapscope.envs.vector.courses import Courses
from gapscope.envs.vector.readings import Readings, VelocityFilters
from gapscope.envs.vector.simulated_arms import ONE_BY_ONE, SimulatedArms


class _Diverged(NamedTuple):
    """What an arm had when it diverged: steps of the action done until then, torque [N m], motion [rad], [rad/s]."""

    done: int
    torque: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    applied: np.ndarray


class ControlledArms:
    """N simulated arms with effects under their controllers, n joints.

    Args:
        setup: of the environments.
        count: N.
        threads: on which they are stepped, see ``gapscope.envs.engines.mujoco_batch``.

    Attributes:
        effects: of each arm beyond the base.
        position, velocity, torque: as those of ``ControlledArm``, shape (N, n).
        q, dq, applied: true motion [rad], [rad/s] and torque [N m] after an action, shape (N, n).
        torque_rate, load: as those of ``ControlledArm``, shape (N,).

    Raises:
        InputError: an arm that cannot be stepped beside others.
    """

    def __init__(self, setup: Setup, count: int, threads: int = 0) -> None:
        self._control, self._timing = setup.control, setup.timing
        self._encoder_step = setup.arm.encoder_step or 0.0
        if setup.base.residual is not None:
            raise InputError(
                "the vector environment does not step a residual network",
                ONE_BY_ONE,
                where="simulated",
            )
        arm, dt = setup.base.arm, setup.timing.dt
        self._arms = SimulatedArms(arm, setup.effects, dt, count, threads)
        nominal = self._arms.nominal
        self._order, self._places = nominal.order, nominal.places
        self._ordered = bool((self._order == np.arange(arm.n_joints)).all())
        drive = self._arms.drive(setup.effects)
        encoders = self._encoders(drive)
        self.effects: list[tuple[AppliedEffect, ...]] = [setup.effects] * count
        self._drives = [drive] * count
        self._chunk = 1 if setup.control.gains else sensor_chunk(setup.timing)
        rate = 1.0 / (dt * self._chunk)
        shape = (count, arm.n_joints)
        self._readings = Readings(encoders, setup.encoder_noise, shape)
        self._estimate = VelocityFilters(rate, shape)
        planned = len(range(setup.layout.size)[setup.layout.planned])
        self.courses = Courses(setup.timing, *shape, planned)
        self._home = np.zeros(shape)
        self.position, self.velocity, self.torque = np.zeros((3, *shape))
        self.q, self.dq, self.applied = np.zeros((3, *shape))
        self.load, self.torque_rate = np.zeros((2, count))
        self._diverged: dict[int, _Diverged] = {}

    def _encoders(self, drive: ArmDrive) -> Encoders:
        return Encoders(drive.corrected, self._encoder_step)

    def reset(
        self,
        number: int,
        effects: tuple[AppliedEffect, ...],
        course: Course,
        seed: np.ndarray,
    ) -> None:
        """Put an arm, numbered from 0, where its encoders read the start of the course, with these effects.

        ``seed`` is that of the encoders' noise, whole numbers of shape (k,).

        Raises:
            InputError: it cannot be stepped beside others with one of the effects.
        """
        if effects is not self.effects[number]:
            drive = self._arms.drive(effects)
            self._drives[number], self.effects[number] = drive, effects
            self._arms.put(number, drive)
        encoders = self._encoders(self._drives[number])
        self._readings.put(number, encoders, seed)
        self.courses.put(number, course)
        start, still = course.q[0], np.zeros(len(course.dq))
        true, order = encoders.undone(start), self._order
        self._arms.reset(number, true[order], course.dq[order])
        self._home[number] = true[order]
        moving = self._control.gains is None
        first = (start, course.dq) if moving else (still, still)
        self._estimate.put(number, *first)
        self.position[number] = self._readings.of(number, true)
        self.velocity[number] = course.dq
        self.torque[number] = course.step_torque[0]
        self.q[number], self.dq[number], self.applied[number] = true, course.dq, 0.0
        self.load[number] = self.torque_rate[number] = 0.0

    def act(self, at: np.ndarray, action: np.ndarray) -> np.ndarray:
        """Carry out the actions, shape (N, ...), numbered ``at`` from 0; returns the steps that each has done.

        They are fewer than those of an action if an arm diverged.
        """
        self._diverged = {}
        kept = self.velocity
        if self._control.gains is None:
            self._command(action)
        else:
            self._track(at, action)
        self.q, self.dq, self.applied = (
            self._own(x) for x in (self._arms.q, self._arms.dq, self._arms.applied)
        )
        done = np.full(len(at), self._timing.sub_steps)
        for number, end in self._diverged.items():
            done[number] = end.done
            self.torque[number], self.position[number] = end.torque, end.position
            self.q[number], self.dq[number] = end.q, end.dq
            self.applied[number] = end.applied
            # the velocity of the PD law is noted at the end of an action only
            tracked = self._control.gains is not None
            self.velocity[number] = kept[number] if tracked else end.velocity
        return done

    def _command(self, action: np.ndarray) -> None:
        """Hold the torque of each action."""
        control, steps = self._control, self._timing.sub_steps
        before, scaled_action = self.torque, control.scale * action
        self.torque = np.clip(scaled_action, -control.limit, control.limit)
        commanded = self.torque
        for done in range(0, steps, self._chunk):
            self._hold(commanded, done)
            self.velocity = self._estimate(self.position).copy()
        held = np.full(len(action), steps)
        for number, end in self._diverged.items():
            held[number] = min(end.done + self._chunk, steps)
        share, jump = commanded / control.rated, commanded - before
        squares, jumps = np.vecdot(share, share), np.vecdot(jump, jump)
        self._note(held * squares, jumps, held)

    def _track(self, at: np.ndarray, action: np.ndarray) -> None:
        """PD with feedforward at every step, with what the action adds or multiplies."""
        control, before = self._control, self.torque
        assert control.gains is not None
        added: np.ndarray | float = 0.0
        factor: np.ndarray | float = 1.0
        gains: Gains = control.gains
        if control.multiplies:
            factor, gains = scaled(gains, action)
        else:
            added = control.scale * action
        reference, feedforward = self.courses.steps(at)
        wanted = feedforward[:-1] * factor + added
        limit, lowest = control.limit, -control.limit
        error = reference[0] - self.position
        rate = self.courses.rate(at) - self.velocity
        for done, torque in enumerate(wanted):  # rows, filled in place
            torque += gains.kp * error
            torque += gains.kd * rate
            np.maximum(torque, lowest, out=torque)
            np.minimum(torque, limit, out=torque)
            self._hold(torque, done)
            error = reference[done + 1] - self.position
            rate = self._estimate(error)
        self.velocity = self.courses.rate(at + 1) - rate
        self.torque = wanted[-1].copy()
        self._note_series(wanted, before)

    def _hold(self, torque: np.ndarray, done: int) -> None:
        """Hold a torque [N m], (N, n), until the encoders are read again.

        An arm that diverged waits at its start until its next episode.
        """
        arms = self._arms
        arms.hold(torque if self._ordered else torque[:, self._order], self._chunk)
        if not np.abs(arms.dq).max() <= FASTEST_OBSERVED:
            fast = ~(np.abs(arms.dq).max(axis=1) <= FASTEST_OBSERVED)
            for number in np.flatnonzero(fast).tolist():
                self._stop(number, done, torque[number])
        q = arms.q if self._ordered else arms.q[:, self._places]
        self.position = self._readings(q)

    def _stop(self, number: int, done: int, torque: np.ndarray) -> None:
        """Note what an arm had when it diverged, if this is the first time in the action, and park it."""
        arms = self._arms
        if number not in self._diverged:
            self._diverged[number] = _Diverged(
                done,
                torque.copy(),
                self.position[number].copy(),
                self.velocity[number].copy(),
                self._own(arms.q)[number],
                self._own(arms.dq)[number],
                self._own(arms.applied)[number],
            )
        arms.reset(number, self._home[number], np.zeros(len(torque)))

    def _own(self, values: np.ndarray) -> np.ndarray:
        """A copy of values (N, n) in kinematic order, in the arm's order."""
        return values.copy() if self._ordered else values[:, self._places]

    def _note_series(self, torque: np.ndarray, before: np.ndarray) -> None:
        """Note the torque of an action's steps [N m], (S, N, n), and of the step before, (N, n)."""
        series = np.ascontiguousarray(torque.transpose(1, 0, 2))
        share = series / self._control.rated
        jumps = np.diff(series, axis=1, prepend=before[:, None])
        flat = [x.reshape(len(series), -1) for x in (share, jumps)]
        squares, changes = (np.vecdot(x, x) for x in flat)
        steps = np.full(len(series), series.shape[1])
        for number, end in self._diverged.items():
            # what was commanded after it had diverged does not count
            until = slice(0, end.done + 1)
            steps[number] = end.done + 1
            part, change = share[number, until], jumps[number, until]
            squares[number] = np.vdot(part, part)
            changes[number] = np.vdot(change, change)
        self._note(squares, changes, steps)

    def _note(self, squares: np.ndarray, jumps: np.ndarray, steps: np.ndarray) -> None:
        """Note the sums over an action's steps of (tau / tau_rated)^2 [1] and of (change of tau)^2 [N^2 m^2], (N,)."""
        count = steps * len(self._control.rated)
        self.load = squares / count
        self.torque_rate = np.sqrt(jumps / count) / self._timing.dt
