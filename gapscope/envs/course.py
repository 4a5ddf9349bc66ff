"""The course of one episode: reference and feedforward at every step, computed before it starts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from gapscope.arm.dynamics.feedforward import feedforward
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import ReferenceMotion
from gapscope.arm.nominal import NominalArm
from gapscope.envs.actions import Control

LOOK_AHEAD = (0.02, 0.1, 0.2)
"""How far ahead the reference is observed, unless said otherwise [s]."""
TIME_STEP, SUB_STEPS = 1e-3, 20
"""Step of the simulation [s] and steps of an action, unless said otherwise."""
EXTENSION = 0.25
"""A model is evaluated this far beyond the end, for delays to look ahead [s]."""


class FeedforwardModel(Protocol):
    """A model whose torque is fed forward."""

    def series(self, motion: Motion) -> np.ndarray:
        """Torque to command over a motion known beforehand [N m], shape (N, n)."""


class Timing:
    """Time of an episode.

    Attributes:
        dt: step of the simulation [s].
        sub_steps: steps per action.
        actions: actions per episode.
        look_ahead: times ahead at which the reference is observed [s].
    """

    def __init__(
        self, dt: float, sub_steps: int, duration: float, look_ahead: Sequence[float]
    ) -> None:
        self.dt, self.sub_steps = dt, sub_steps
        self.actions = max(1, int(np.ceil(duration / self.period - 1e-9)))
        self.look_ahead = tuple(look_ahead)

    @property
    def period(self) -> float:
        """Time between actions [s]."""
        return self.dt * self.sub_steps

    @property
    def duration(self) -> float:
        """Duration of an episode, a whole number of periods [s]."""
        return self.period * self.actions


class Course:
    """Reference and feedforward of one episode, K actions of S steps, n joints.

    Attributes:
        q: reference position when an action is chosen, and at the end [rad], shape (K + 1, n).
        dq: its velocity at the start [rad/s], shape (n,).
        planned: the planned part of the observation at these times, shape (K + 1, ...).
        step_q, step_dq: reference at each step, and at the end [rad], [rad/s], shape (K S + 1, n).
        step_torque: feedforward at these times [N m], shape (K S + 1, n).
        motion: the reference at each step, with a model ``EXTENSION`` further.

    Args:
        arm: the nominal arm.
        body: its rigid-body model.
        model: one of ``gapscope.arm.dynamics.feedforward.KINDS``, or a model.
        reference: the motion.
        timing: of the episode.
        control: how actions become torque.
    """

    def __init__(
        self,
        arm: NominalArm,
        body: RigidBody,
        model: str | FeedforwardModel,
        reference: ReferenceMotion,
        timing: Timing,
        control: Control,
    ) -> None:
        steps = timing.actions * timing.sub_steps + 1
        self.motion = sampled(
            reference,
            timing,
            steps + (0 if isinstance(model, str) else round(EXTENSION / timing.dt)),
        )
        chosen = slice(0, steps, timing.sub_steps)
        t, self.q, dq = (
            self.motion.t[chosen],
            self.motion.q[chosen],
            self.motion.dq[chosen],
        )
        ahead = [reference.position(t + time) - self.q for time in timing.look_ahead]
        self.dq = dq[0]
        if isinstance(model, str):
            self.step_torque = feedforward(
                arm, body, model, self.motion.q, self.motion.dq, self.motion.ddq
            )
        else:
            self.step_torque = np.asarray(model.series(self.motion))[:steps]
        self.step_q, self.step_dq = self.motion.q, self.motion.dq
        torque = self.step_torque[:: timing.sub_steps] / control.rated
        self.planned = np.hstack([self.q, dq, *ahead, torque])


def sampled(reference: ReferenceMotion, timing: Timing, steps: int) -> Motion:
    """A reference at so many steps of the simulation."""
    t = timing.dt * np.arange(steps)
    return Motion(
        t, reference.position(t), reference.velocity(t), reference.acceleration(t)
    )
