"""The plant that agents act on: simulated arms with encoders, velocity estimates and, if wanted, PD loops.

One environment's plant is one of N.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy import add, maximum, minimum, multiply, subtract

from gapscope.arm.velocity_filter import VelocityFilter, filter_gains
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected_file import described
from gapscope.envs.actions import Gains, scaled
from gapscope.envs.divergence import divergence_info, stop_info
from gapscope.envs.episode import FASTEST_OBSERVED, SampledReference, Setup, Timing
from gapscope.envs.position_controller import VELOCITY_DAMPING, cutoff
from gapscope.envs.simulated_arm import NetworkTorque, SimulatedArms

SENSOR_PERIOD = 10e-3
"""The encoders are read at least this often [s], and at every step if a PD loop runs."""
SLOW = FASTEST_OBSERVED**2
"""Sum of squares of velocities of which none exceeds what is observed [rad^2/s^2]."""


class SampledReferences:
    """Courses of N episodes, K actions of S steps, n joints; each at an action of its own.

    An episode that is over stands still for the action in which it waits for the next one.

    Args:
        timing: of the episodes.
        count: N.
        n_joints: n.
        planned: numbers in the planned part of the observation.

    Attributes:
        at: number of the next action of each, shape (N,).
        planned: the planned part of the observation then, shape (N, ...).
        position, rate: the reference then [rad], [rad/s], which that part begins with, shape (N, n).
    """

    def __init__(self, timing: Timing, count: int, n_joints: int, planned: int) -> None:
        self._sub_steps = timing.sub_steps
        self.at: np.ndarray = np.zeros(count, dtype=int)
        self.planned = np.zeros((count, planned))
        self.position = self.planned[:, :n_joints]
        self.rate = self.planned[:, n_joints : 2 * n_joints]
        # rows of actions; reference and feedforward of steps
        none = np.zeros((timing.actions + 2, planned))
        still = np.zeros((2, (timing.actions + 1) * timing.sub_steps + 1, n_joints))
        self._plans, self._series = [none] * count, [still] * count

    def put(self, number: int, course: SampledReference) -> None:
        """Give an episode, numbered from 0, another course, at whose start it is."""
        self.at[number], self.planned[number] = 0, course.planned[0]
        self._plans[number] = np.pad(course.planned, ((0, 1), (0, 0)), "edge")
        series = np.stack(
            [course.step_q[: len(course.step_torque)], course.step_torque]
        )
        waiting = ((0, 0), (0, self._sub_steps), (0, 0))
        self._series[number] = np.pad(series, waiting, "edge")

    def steps(self) -> tuple[np.ndarray, np.ndarray]:
        """Reference [rad] and feedforward [N m] at the steps of the next action, the first after it included.

        Two arrays of shape (S + 1, N, n).
        """
        count = self._sub_steps
        both = np.empty((2, count + 1, *self.position.shape))
        for number, at in enumerate(self.at.tolist()):
            rows = slice(at * count, at * count + count + 1)
            both[:, :, number] = self._series[number][:, rows]
        return both[0], both[1]

    def go_on(self) -> None:
        """The next action is done."""
        self.at += 1
        for number, at in enumerate(self.at.tolist()):
            self.planned[number] = self._plans[number][at]


class VelocityFilters:
    """``VelocityFilter`` of N arms, n joints.

    Args:
        rate: sampling rate [Hz].
        shape: (N, n).
    """

    def __init__(self, rate: float, shape: tuple[int, int]) -> None:
        self._rate = rate
        gains = np.array(filter_gains(rate, cutoff(rate), VELOCITY_DAMPING))
        pasts: np.ndarray = np.zeros((2, 5, shape[0] * shape[1]))
        self._product, tables = gains.dot, pasts
        if shape[0] > 1:
            # one product per arm: a single large one would round differently
            self._product = partial(np.matmul, gains)
            tables = pasts.reshape(2, 5, *shape).swapaxes(1, 2)
        # from one array into the other, in turns: numpy takes longer to move rows within one, and to slice again
        self._turns = [
            (past[0], past[:-1], past[1:], table, table[..., 3, :], past[3])
            for past, table in zip(pasts, tables, strict=True)
        ]
        self._pasts = [past.reshape(5, *shape) for past in pasts]

    def put(self, number: int, position: np.ndarray, velocity: np.ndarray) -> None:
        """Start an arm at a position [rad], until which it had a velocity [rad/s], each (n,)."""
        rate = self._rate
        one = VelocityFilter(rate, cutoff(rate), VELOCITY_DAMPING, position, velocity)
        self._pasts[0][:, number] = one.past

    def __call__(self, q: np.ndarray) -> np.ndarray:
        """Filtered velocities [rad/s] for the next positions q [rad], (N n,); valid until the next call but one."""
        newest, kept, _, table, _, _ = self._turns[0]
        _, _, older, _, result, velocity = self._turns[1]
        newest[...] = q
        older[...] = kept
        self._product(table, out=result)
        self._turns.reverse()
        self._pasts.reverse()
        return velocity


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

    If PD loops run, the tracking error is differentiated and not the position: dq = dq_ref - D(q_ref - q), so that the
    differentiator's lag is not treated as an error. Otherwise dq = D(q).

    Args:
        setup: of the environments.
        count: N.
        engine, together, threads: as of ``gapscope.envs.simulated_arm.SimulatedArms``.

    Attributes:
        position: as the encoders give it, quantised as the data sheet says [rad], shape (N, n).
        velocity: estimate from the encoders [rad/s], shape (N, n).
        torque: commanded in the last step [N m], shape (N, n).
        q, dq, applied: true motion [rad], [rad/s] and torque [N m] after an action, shape (N, n).
        torque_rate: RMS over joints and steps of the last action of the change of the torque commanded [N m/s], (N,).
        load: mean of (commanded / rated torque)^2 over joints and steps of the last action [1], (N,); of an action in
            which an arm diverged, both are over its steps until then.
        courses: what the arms are to follow.
        diverged: the arms that diverged in the last action, by number.

    Raises:
        InputError: an engine that is not there, or arms that cannot be stepped together.
    """

    def __init__(
        self,
        setup: Setup,
        count: int = 1,
        *,
        engine: str | None = None,
        together: bool = False,
        threads: int = 0,
    ) -> None:
        self.setup, self._control, self._timing = setup, setup.control, setup.timing
        self._arms = SimulatedArms(
            setup.base.arm,
            setup.options.effects,
            setup.timing.dt,
            count,
            engine=engine,
            encoder_step=setup.arm.encoder_step or 0.0,
            encoder_noise=setup.encoder_noise,
            together=together,
            threads=threads,
        )
        self._networks: dict[int, NetworkTorque] = {}
        # steps between readings of the encoders: as many as fit, and divide those of an action
        self._chunk, parts = 1, setup.timing.sub_steps
        if setup.control.gains is None:
            fits = max(1, int(SENSOR_PERIOD / setup.timing.dt + 1e-9))
            self._chunk = max(x for x in range(1, fits + 1) if parts % x == 0)
        rate = 1.0 / (setup.timing.dt * self._chunk)
        shape = (count, setup.arm.n_joints)
        self._estimate = VelocityFilters(rate, shape)
        planned = len(range(setup.layout.size)[setup.layout.planned])
        self.courses = SampledReferences(setup.timing, *shape, planned)
        self._home = np.zeros(shape)
        self.position, self.velocity, self.torque = np.zeros((3, *shape))
        self.q, self.dq, self.applied = np.zeros((3, *shape))
        self.load, self.torque_rate = np.zeros((2, count))
        self.diverged: dict[int, _Diverged] = {}
        # of the joints of all arms: numpy takes longer for what it must spread
        control = setup.control
        self._gains = control.gains and Gains(
            *(np.tile(gain, count) for gain in control.gains)
        )
        self._limit = np.tile(control.limit, count)
        self._scale, self._rated = (
            np.tile(x, (count, 1)) for x in (control.scale, control.rated)
        )
        self._lowest = -self._limit
        self._error, self._work = np.zeros((2, self._limit.size))
        self._series = np.zeros((2, count, setup.timing.sub_steps, shape[1]))

    @property
    def effects(self) -> list[tuple[AppliedEffect, ...]]:
        """Effects of each arm beyond the base."""
        return self._arms.effects

    def close(self) -> None:
        """Free the engine."""
        self._arms.close()

    def reset(
        self,
        number: int,
        effects: tuple[AppliedEffect, ...],
        course: SampledReference,
        seed: np.ndarray,
    ) -> None:
        """Put an arm, numbered from 0, where its encoders read the start of the course, with these effects.

        ``seed`` is that of the encoders' noise, whole numbers of shape (k,).

        Raises:
            InputError: one of the effects cannot be simulated, or not beside other arms.
        """
        arms = self._arms
        arms.put(number, effects)
        arms.draw_noise_from(number, np.random.default_rng(seed))
        self.courses.put(number, course)
        start, still = course.q[0], np.zeros(len(course.dq))
        arms.start(number, start, course.dq)
        self._home[number] = self.q[number] = arms.in_order(arms.inside.q)[number]
        moving = self._control.gains is None
        first = (start, course.dq) if moving else (still, still)
        self._estimate.put(number, *first)
        self.position[number] = arms.read_one(number)
        self.velocity[number] = course.dq
        self.torque[number] = course.step_torque[0]
        self.dq[number], self.applied[number] = course.dq, 0.0
        self.load[number] = self.torque_rate[number] = 0.0
        if self.setup.base.residual is not None:
            having = replace(self.setup.base, effects=effects)
            steps = self._timing.sub_steps
            self._networks[number] = NetworkTorque(having, course.motion, steps)

    def truth(self, number: int) -> dict[str, Any]:
        """True motion [rad], [rad/s], torque [N m] and effects of an arm if they are told; hidden from controllers."""
        if not self.setup.debug:
            return {}
        return {
            "q_true": self.q[number].copy(),
            "dq_true": self.dq[number].copy(),
            "torque_commanded": self.torque[number].copy(),
            "torque_applied": self.applied[number].copy(),
            "effects": [described(applied) for applied in self.effects[number]],
        }

    def early_end(self, number: int, acted: bool) -> dict[str, Any]:
        """Why the episode of an arm ends early, if it does, after the last action.

        ``acted``: whether one of its actions was other than zero.
        """
        reading = self.position[number]
        if number not in self.diverged:
            return dict(stop_info(self.setup, self.q[number], reading))
        before = int(self.courses.at[number] - 1) * self._timing.sub_steps
        until = before + self.diverged[number].done
        state = reading, self.dq[number]
        hidden = self.effects[number]
        return divergence_info(self.setup, until, *state, hidden, acted)

    def act(self, action: np.ndarray) -> None:
        """Carry out the next action of each, shape (N, ...); the courses go on."""
        self.diverged, kept, courses = {}, self.velocity, self.courses
        for number, network in self._networks.items():
            now = self.position[number], self.velocity[number]
            network.see(int(courses.at[number]), *now)
        if self._control.gains is None:
            self._command(action)
            courses.go_on()
        else:
            self._track(action)
        in_order, inside = self._arms.in_order, self._arms.inside
        self.q, self.dq = in_order(inside.q), in_order(inside.dq)
        self.applied = in_order(inside.applied)
        for number, end in self.diverged.items():
            self.torque[number], self.position[number] = end.torque, end.position
            self.q[number], self.dq[number] = end.q, end.dq
            self.applied[number] = end.applied
            # the velocity of the PD law is noted at the end of an action only
            tracked = self._control.gains is not None
            self.velocity[number] = kept[number] if tracked else end.velocity

    def _command(self, action: np.ndarray) -> None:
        """Hold the torque of each action."""
        steps, before, estimate = self._timing.sub_steps, self.torque, self._estimate
        self.torque = self._scale * action
        commanded = self.torque.ravel()
        maximum(commanded, self._lowest, commanded)
        minimum(commanded, self._limit, commanded)
        for done in range(0, steps, self._chunk):
            velocity = estimate(self._hold(commanded, done))
            self.velocity = velocity.reshape(before.shape)
        self.velocity = self.velocity.copy()
        share, jump = self.torque / self._rated, self.torque - before
        held = self._steps_of(steps)
        for number, end in self.diverged.items():
            held[number] = min(end.done + self._chunk, steps)
        squares, jumps = np.vecdot(share, share), np.vecdot(jump, jump)
        self._note(held * squares, jumps, held)

    def _track(self, action: np.ndarray) -> None:
        """PD with feedforward at every step, with what the action adds or multiplies."""
        control, courses, gains = self._control, self.courses, self._gains
        assert control.gains is not None and gains is not None
        before, velocity = self.torque, self.velocity
        reference, wanted = courses.steps()
        wanted = wanted[:-1]
        if control.multiplies:
            factor, scaled_gains = scaled(control.gains, action)
            wanted *= factor
            gains = Gains(*(gain.ravel() for gain in scaled_gains))
        else:
            wanted += self._scale * action
        kp, kd, lowest, limit = *gains, self._lowest, self._limit
        error, work, estimate = self._error, self._work, self._estimate
        rate = (courses.rate - velocity).ravel()
        subtract(reference[0].ravel(), self.position.ravel(), error)
        # rows, filled in place
        torques, following = (
            series.reshape(len(wanted), -1) for series in (wanted, reference[1:])
        )
        for done, (torque, after) in enumerate(zip(torques, following, strict=True)):
            multiply(kp, error, work)
            add(torque, work, torque)
            multiply(kd, rate, work)
            add(torque, work, torque)
            maximum(torque, lowest, torque)
            minimum(torque, limit, torque)
            subtract(after, self._hold(torque, done), error)
            rate = estimate(error)
        courses.go_on()
        self.velocity = courses.rate - rate.reshape(before.shape)
        self.torque = wanted[-1].copy()
        self._note_series(wanted, before)

    def _hold(self, torque: np.ndarray, done: int) -> np.ndarray:
        """Hold a torque [N m], (N n,), until the encoders are read again; the readings [rad], (N n,).

        An arm that diverged waits at its start until its next episode.
        """
        arms, felt = self._arms, torque
        if self._networks:
            felt = torque.copy()
            for number, network in self._networks.items():
                table = felt.reshape(self.q.shape)
                step = self.courses.at[number] * self._timing.sub_steps + done
                table[number] -= network.torque(step)
        arms.hold(felt, self._chunk)
        dq = arms.inside.dq
        # fast: no joint is faster than all together
        if not dq.dot(dq) <= SLOW:
            speeds = np.abs(dq).reshape(self.q.shape).max(axis=1)
            for number in np.flatnonzero(~(speeds <= FASTEST_OBSERVED)).tolist():
                self._stop(number, done, torque.reshape(self.q.shape)[number])
        reading = arms.read()
        self.position = reading.reshape(self.q.shape)
        return reading

    def _stop(self, number: int, done: int, torque: np.ndarray) -> None:
        """Note what an arm had when it diverged, if this is the first time in the action, and park it."""
        arms, inside = self._arms, self._arms.inside
        if number not in self.diverged:
            self.diverged[number] = _Diverged(
                done,
                torque.copy(),
                self.position[number].copy(),
                self.velocity[number].copy(),
                *(
                    arms.in_order(values)[number]
                    for values in (inside.q, inside.dq, inside.applied)
                ),
            )
        arms.reset(number, self._home[number], np.zeros(len(torque)))

    def _note_series(self, torque: np.ndarray, before: np.ndarray) -> None:
        """Note the torque of an action's steps [N m], (S, N, n), and of the step before, (N, n)."""
        share, jumps = self._series
        series = torque.transpose(1, 0, 2)
        np.divide(series, self._control.rated, share)
        subtract(series[:, 0], before, jumps[:, 0])
        subtract(series[:, 1:], series[:, :-1], jumps[:, 1:])
        flat = self._series.reshape(2, len(share), -1)
        squares, changes = np.vecdot(flat, flat)
        steps = self._steps_of(len(torque))
        for number, end in self.diverged.items():
            # what was commanded after it had diverged does not count
            until = slice(0, end.done + 1)
            steps[number] = end.done + 1
            part, change = share[number, until], jumps[number, until]
            squares[number] = np.vdot(part, part)
            changes[number] = np.vdot(change, change)
        self._note(squares, changes, steps)

    def _steps_of(self, steps: int) -> Any:
        """Steps of an action, of each arm if one of them may have done fewer: numpy takes longer for an array."""
        return np.full(len(self.load), steps) if self.diverged else steps

    def _note(self, squares: np.ndarray, jumps: np.ndarray, steps: Any) -> None:
        """Note the sums over an action's steps of (tau / tau_rated)^2 [1] and of (change of tau)^2 [N^2 m^2], (N,)."""
        count = steps * len(self._control.rated)
        self.load = squares / count
        self.torque_rate = np.sqrt(jumps / count) / self._timing.dt
