"""The plant that an agent acts on: the simulated arm with its encoders, velocity estimate and, if wanted, a PD loop."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.velocity_filter import VelocityFilter
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.actions import Gains, scaled
from gapscope.envs.course import Course, Timing
from gapscope.envs.divergence import diverged
from gapscope.envs.episode import Setup
from gapscope.envs.network_torque import NetworkTorque
from gapscope.envs.simulated_arm import SimulatedArm
from gapscope.envs.velocity_estimate import VELOCITY_DAMPING, cutoff

SENSOR_PERIOD = 10e-3
"""The encoders are read at least this often [s], and at every step if a PD loop runs."""


class ControlledArm:
    """A simulated arm with effects under its controller, n joints.

    If a PD loop runs, the tracking error is differentiated and not the position: dq = dq_ref - D(q_ref - q), so that
    the differentiator's lag is not treated as an error. Otherwise dq = D(q).

    Args:
        setup: of the environment.
        engine: name of the engine.

    Attributes:
        effects: what it has beyond the base.
        simulated: the simulated arm.
        position: as the encoders give it, quantised as the data sheet says [rad], shape (n,).
        velocity: estimate from the encoders [rad/s], shape (n,).
        torque: commanded in the last step [N m], shape (n,).
        torque_rate: RMS over joints and steps of the last action of the change of the torque commanded [N m/s].
        load: mean of (commanded / rated torque)^2 over joints and steps of the last action [1]; of an action in which
            the arm diverged, both are over its steps until then.

    Raises:
        InputError: an engine that is not there, or that cannot simulate one of the effects.
    """

    def __init__(
        self,
        setup: Setup,
        engine: str | None,
    ) -> None:
        self._base, self._encoder_step = setup.base, setup.arm.encoder_step or 0.0
        self._encoder_noise, effects = setup.encoder_noise, setup.effects
        self._rng = np.random.default_rng()
        self._engine, self._control, self._timing = engine, setup.control, setup.timing
        self._nominal: RigidBody | None = None
        self.effects, self.simulated = effects, self._simulate(effects)
        self._nominal = self.simulated.nominal
        self._chunk = (
            1 if setup.control.gains is not None else sensor_chunk(setup.timing)
        )
        self._network: NetworkTorque | None = None
        self._lowest = -setup.control.limit

    def close(self) -> None:
        """Free the engine."""
        self.simulated.close()

    def reset(
        self, effects: tuple[AppliedEffect, ...], course: Course, seed: np.ndarray
    ) -> None:
        """Put the arm where its encoders read the start of the course, with these effects.

        ``seed`` is that of the encoders' noise, whole numbers of shape (k,).

        Raises:
            InputError: the engine cannot simulate one of the effects.
        """
        self._rng.bit_generator.state = np.random.default_rng(seed).bit_generator.state
        if effects is not self.effects:
            simulated = self._simulate(effects)
            self.close()
            self.simulated, self.effects = simulated, effects
        self._course = course
        self.simulated.start(course.q[0], course.dq)
        rate, still = 1.0 / (self._timing.dt * self._chunk), np.zeros(len(course.dq))
        start = (
            (course.q[0], course.dq) if self._control.gains is None else (still, still)
        )
        self._estimate = VelocityFilter(rate, cutoff(rate), VELOCITY_DAMPING, *start)
        self.position, self.velocity = self.simulated.encoders(), course.dq
        self.torque, self.load, self.torque_rate = course.step_torque[0], 0.0, 0.0
        if self._base.residual is not None:
            self._network = NetworkTorque(
                replace(self._base, effects=effects),
                course.motion,
                self._timing.sub_steps,
            )

    def act(self, number: int, action: np.ndarray) -> int:
        """Carry out an action, shape (n,), numbered from 0; returns the steps done, fewer if it diverged."""
        control, first = self._control, number * self._timing.sub_steps
        if self._network is not None:
            self._network.see(number, self.position, self.velocity)
        if control.gains is not None:
            if control.multiplies:
                return self._track(first, 0.0, *scaled(control.gains, action))
            return self._track(first, control.scale * action, 1.0, control.gains)
        before, torque = self.torque, control.scale * action
        np.maximum(torque, self._lowest, out=torque)
        self.torque = np.minimum(torque, control.limit, out=torque)
        share, jump = self.torque / control.rated, self.torque - before
        steps, done = self._timing.sub_steps, 0
        while done < steps and self._step(first + done):
            self.velocity = self._estimate(self.position)
            done += self._chunk
        held = min(done + self._chunk, steps)
        self._note(held * share.dot(share), jump.dot(jump), held)
        return done

    def _track(
        self,
        first: int,
        added: np.ndarray | float,
        factor: np.ndarray | float,
        gains: Gains,
    ) -> int:
        """PD with feedforward times a factor, and a torque [N m] added, from this step of the course on."""
        course, limit, steps = self._course, self._control.limit, self._timing.sub_steps
        lowest, kp, kd = self._lowest, gains.kp, gains.kd
        estimate, step = self._estimate, self._step
        wanted = course.step_torque[first : first + steps] * factor + added
        reference, before = course.step_q[first + 1 :], self.torque
        error, rate = (
            course.step_q[first] - self.position,
            course.step_dq[first] - self.velocity,
        )
        for done, torque in enumerate(wanted):  # rows, filled in place
            torque += kp * error
            torque += kd * rate
            np.maximum(torque, lowest, out=torque)
            self.torque = np.minimum(torque, limit, out=torque)
            if not step(first + done):
                self._note_series(wanted[: done + 1], before)
                return done
            error = reference[done] - self.position
            rate = estimate(error)
        self.velocity = course.step_dq[first + steps] - rate
        self._note_series(wanted, before)
        return steps

    def _note_series(self, torque: np.ndarray, before: np.ndarray) -> None:
        """Note the torque of an action's steps [N m], shape (S, n), and of the step before, shape (n,)."""
        share, jumps = (
            torque / self._control.rated,
            np.diff(torque, axis=0, prepend=before[None]),
        )
        self._note(
            float(np.vdot(share, share)), float(np.vdot(jumps, jumps)), len(torque)
        )

    def _note(self, squares: float, jumps: float, steps: int) -> None:
        """Note the sums over an action's steps of (tau / tau_rated)^2 [1] and of (change of tau)^2 [N^2 m^2]."""
        count = steps * len(self._control.rated)
        self.load = float(squares / count)
        self.torque_rate = math.sqrt(jumps / count) / self._timing.dt

    def _step(self, step: int) -> bool:
        """Hold the torque until the encoders are read again; whether the arm has not diverged."""
        torque, simulated = self.torque, self.simulated
        if self._network is not None:
            torque = torque - self._network.torque(step)
        simulated.step(torque, self._chunk)
        # of the true velocity: a fast oscillation hardly shows in the estimate
        if diverged(simulated.present_dq):
            return False
        self.position = simulated.encoders()
        return True

    def _simulate(self, effects: tuple[AppliedEffect, ...]) -> SimulatedArm:
        return SimulatedArm(
            self._base.arm,
            effects,
            self._timing.dt,
            engine=self._engine,
            encoder_step=self._encoder_step,
            encoder_noise=self._encoder_noise,
            rng=self._rng,
            nominal=self._nominal,
        )


def sensor_chunk(timing: Timing) -> int:
    """Steps between readings of the encoders: as many as fit into ``SENSOR_PERIOD``, and divide those of an action."""
    fits = max(1, int(SENSOR_PERIOD / timing.dt + 1e-9))
    return max(steps for steps in range(1, fits + 1) if timing.sub_steps % steps == 0)
