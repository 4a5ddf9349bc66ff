"""The course of one episode: reference and feedforward at every step, worked out before it starts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from arm.dynamics import RigidBody
from arm.feedforward import feedforward
from arm.nominal import NominalArm
from arm.trajectory import Reference
from envs.actions import Control


class Timing:
    """Time of an episode.

    Attributes:
        dt: step of the simulation [s].
        sub_steps: steps per action.
        actions: actions per episode.
        look_ahead: times ahead at which the reference is observed [s].
    """

    def __init__(self, dt: float, sub_steps: int, duration: float, look_ahead: Sequence[float]) -> None:
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
        step_q, step_dq: reference at each step [rad], [rad/s], shape (K S, n); only where a PD loop runs there.
        step_torque: feedforward at each step [N m], shape (K S, n).
    """

    def __init__(
        self, arm: NominalArm, body: RigidBody, kind: str, reference: Reference, timing: Timing, control: Control
    ) -> None:
        t = timing.period * np.arange(timing.actions + 1)
        self.q = reference.position(t)
        ahead = [reference.position(t + time) - self.q for time in timing.look_ahead]
        dq = reference.velocity(t)
        self.dq = dq[0]
        torque = feedforward(arm, body, kind, self.q, dq, reference.acceleration(t)) / control.rated
        self.planned = np.hstack([self.q, dq, *ahead, torque])
        if control.gains is not None:
            t = timing.dt * np.arange(timing.actions * timing.sub_steps)
            self.step_q, self.step_dq = reference.position(t), reference.velocity(t)
            self.step_torque = feedforward(arm, body, kind, self.step_q, self.step_dq, reference.acceleration(t))
