"""Tracking: a simulated arm with effects follows a reference under a controller, tick by tick."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.agents.controllers import TrackingController
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import ReferenceMotion
from gapscope.arm.velocity_filter import VelocityFilter
from gapscope.envs.divergence import diverged
from gapscope.envs.position_controller import VELOCITY_CUTOFF, VELOCITY_DAMPING
from gapscope.envs.simulated_arm import SimulatedArm

SETTLE = 0.5
"""The start of the reference is held for this long before t = 0 [s]."""
BEYOND = 0.25
"""Feedforward is computed this far beyond the end, for delays to look ahead [s]."""


@dataclass(frozen=True)
class SampledReference:
    """A reference at every tick of a controller, from some time before its start to beyond its end, N ticks.

    Attributes:
        motion: the reference; negative times hold its start [s], [rad], [rad/s], [rad/s^2].
        first: tick of t = 0.
        torque: feedforward of a controller at every tick [N m], shape (N, n), or ``None``.
    """

    motion: Motion
    first: int
    torque: np.ndarray | None = None

    @classmethod
    def of(
        cls,
        reference: ReferenceMotion,
        duration: float,
        dt: float,
        settle: float = SETTLE,
    ) -> SampledReference:
        """Sample a reference that starts at rest.

        Args:
            reference: the motion; it must be defined beyond its end.
            duration: of what is tracked, from t = 0 [s].
            dt: period of the controller [s].
            settle: time before t = 0 [s].
        """
        first = round(settle / dt)
        ticks = np.arange(-first, round((duration + BEYOND) / dt))
        held = np.maximum(ticks, 0) * dt
        moving = (ticks >= 0)[:, None]
        motion = Motion(
            t=ticks * dt,
            q=reference.position(held),
            dq=np.where(moving, reference.velocity(held), 0.0),
            ddq=np.where(moving, reference.acceleration(held), 0.0),
        )
        return cls(motion, first)

    def planned(self, controller: TrackingController) -> SampledReference:
        """The same with the feedforward of a controller."""
        return SampledReference(self.motion, self.first, controller.plan(self.motion))

    @property
    def ticks(self) -> int:
        """Ticks that are tracked."""
        return len(self.motion.t) - round(BEYOND * self.motion.rate)


@dataclass(frozen=True)
class TrackingRun:
    """What an arm did on a course, K ticks from t = 0 on, K less than the course's if it diverged.

    Attributes:
        t: time [s], shape (K,).
        q_ref: reference [rad], shape (K, n).
        q: position as the encoders read it [rad], shape (K, n).
        tau: torque commanded [N m], shape (K, n).
        diverged: whether the arm diverged.
    """

    t: np.ndarray
    q_ref: np.ndarray
    q: np.ndarray
    tau: np.ndarray
    diverged: bool


def track(
    simulated: SimulatedArm,
    controller: TrackingController,
    course: SampledReference,
    *,
    kick: np.ndarray | float = 0.0,
    cutoff: float | None = VELOCITY_CUTOFF,
) -> TrackingRun:
    """Let a simulated arm follow a course; the controller runs at every step of the simulation.

    The velocity that the controller has is dq_ref - D(q_ref - q), with D a second-order low-pass differentiator: as the
    reference is known, only the error must be differentiated, and the differentiator's lag is not treated as an error.

    Args:
        simulated: the arm; its time step is that of the course.
        controller: it is given ``course.torque``.
        course: the reference.
        kick: velocity of the joints at the start [rad/s], a number or shape (n,).
        cutoff: of the differentiator [Hz]; a backward difference if ``None``.
    """
    motion = course.motion
    n = motion.q.shape[1]
    start_speed = np.zeros(n) + kick
    controller.begin(motion)
    simulated.start(motion.q[0], start_speed, float(motion.t[0]))
    error_rate = VelocityFilter(
        1.0 / simulated.dt,
        cutoff,
        VELOCITY_DAMPING,
        np.zeros(n),
        motion.dq[0] - start_speed,
    )
    q, tau = np.empty((2, course.ticks, n))
    done, ran_away = course.ticks, False
    for i in range(course.ticks):
        q_ref, dq_ref, ddq_ref = motion.q[i], motion.dq[i], motion.ddq[i]
        q[i] = simulated.encoders()
        velocity = dq_ref - error_rate(q_ref - q[i])
        planned = None if course.torque is None else course.torque[i]
        tau[i] = controller.torque(q_ref, dq_ref, ddq_ref, q[i], velocity, planned)
        simulated.step(tau[i])
        if diverged(simulated.dq):
            done, ran_away = i, True
            break
    rows = slice(min(course.first, done), done)
    return TrackingRun(motion.t[rows], motion.q[rows], q[rows], tau[rows], ran_away)
