"""The plant that an agent acts on: the simulated arm with its encoders, velocity estimate and, if wanted, a PD loop."""

from __future__ import annotations

import numpy as np

from arm.nominal import NominalArm
from arm.velocity_filter import VelocityFilter
from effects.applied import AppliedEffect
from envs.actions import Control, Gains
from envs.course import Course, Timing
from envs.divergence import diverged
from envs.simulated_arm import SimulatedArm

SENSOR_PERIOD = 10e-3
"""The encoders are read at least this often [s], and at every step where a PD loop runs."""
VELOCITY_CUTOFF = 80.0
"""Cut-off of the velocity estimate [Hz]; at most ``WIDEST`` of the rate at which the encoders are read."""
WIDEST = 0.4
"""Largest cut-off over that rate [1]."""
VELOCITY_DAMPING = 0.9
"""Damping ratio of the velocity estimate [1]."""


class Plant:
    """A simulated arm with effects under its controller, n joints.

    Args:
        arm: the nominal arm.
        engine: name of the engine.
        effects: what the simulated arm has beyond the nominal arm.
        control: how actions become torque.
        timing: of an episode.

    Attributes:
        effects: what it has beyond the nominal arm.
        simulated: the simulated arm.
        position: as the encoders give it, quantised as the data sheet says [rad], shape (n,).
        velocity: estimate from the encoders [rad/s], shape (n,).
        torque: commanded in the last step [N m], shape (n,).
        load: mean of (commanded / rated torque)^2 over joints and steps of the last action [1].

    Raises:
        InputError: an engine that is not there, or that cannot simulate one of the effects.
    """

    def __init__(
        self, arm: NominalArm, engine: str, effects: tuple[AppliedEffect, ...], control: Control, timing: Timing
    ) -> None:
        self._arm, self._engine, self._control, self._timing = arm, engine, control, timing
        self.effects, self.simulated = effects, self._simulate(effects)
        self._chunk = 1 if control.gains is not None else _chunk(timing)

    def close(self) -> None:
        """Free the engine."""
        self.simulated.close()

    def reset(self, effects: tuple[AppliedEffect, ...], course: Course) -> None:
        """Put the arm where its encoders read the start of the course, with these effects.

        Raises:
            InputError: the engine cannot simulate one of them.
        """
        if effects is not self.effects:
            self.close()
            self.simulated, self.effects = self._simulate(effects), effects
        self._course = course
        self.simulated.start(course.q[0], course.dq)
        rate = 1.0 / (self._timing.dt * self._chunk)
        self._estimate = VelocityFilter(
            rate, min(VELOCITY_CUTOFF, WIDEST * rate), VELOCITY_DAMPING, course.q[0], course.dq
        )
        self.position, self.velocity = self.simulated.encoders(), course.dq
        self.torque, self.load = np.zeros(len(course.dq)), 0.0

    def act(self, number: int, action: np.ndarray) -> int:
        """Carry out an action, shape (n,), numbered from 0; returns the steps done, fewer if it diverged."""
        control = self._control
        added = control.scale * action
        if control.gains is not None:
            return self._track(number * self._timing.sub_steps, added, control.gains)
        self.torque = np.minimum(np.maximum(added, -control.limit), control.limit)
        share = self.torque / control.rated
        self.load = float(share.dot(share)) / len(share)
        for done in range(0, self._timing.sub_steps, self._chunk):
            if not self._step():
                return done
        return self._timing.sub_steps

    def _track(self, first: int, added: np.ndarray, gains: Gains) -> int:
        """PD with feedforward, and a torque [N m] added, from this step of the course on."""
        course, limit, rated = self._course, self._control.limit, self._control.rated
        squares, steps = 0.0, self._timing.sub_steps
        for done in range(steps):
            step = first + done
            wanted = course.step_torque[step] + added
            wanted += gains.kp * (course.step_q[step] - self.position)
            wanted += gains.kd * (course.step_dq[step] - self.velocity)
            self.torque = np.minimum(np.maximum(wanted, -limit), limit)
            if not self._step():
                return done
            share = self.torque / rated
            squares += share.dot(share)
        self.load = squares / (steps * len(added))
        return steps

    def _step(self) -> bool:
        """Hold the torque until the encoders are read again; whether the arm has not diverged."""
        self.simulated.step(self.torque, self._chunk)
        if diverged(self.simulated.dq):  # the true one: a fast oscillation hardly shows in the estimate
            return False
        self.position = self.simulated.encoders()
        self.velocity = self._estimate(self.position)
        return True

    def _simulate(self, effects: tuple[AppliedEffect, ...]) -> SimulatedArm:
        step = self._arm.encoder_step or 0.0
        return SimulatedArm(self._arm, effects, self._timing.dt, engine=self._engine, encoder_step=step)


def _chunk(timing: Timing) -> int:
    """Steps between readings of the encoders: as many as fit into ``SENSOR_PERIOD``, and divide those of an action."""
    fits = max(1, int(SENSOR_PERIOD / timing.dt + 1e-9))
    return max(steps for steps in range(1, fits + 1) if timing.sub_steps % steps == 0)
