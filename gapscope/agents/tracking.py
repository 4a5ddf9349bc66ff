"""Tracking: a simulated arm follows a reference, what a track is measured by, and whether the loop is stable."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from typing import NamedTuple

import numpy as np

from gapscope.agents.models import AgentModel, TorqueModel
from gapscope.arm.control import SETTLE, Targets
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.named_motions import Workspace
from gapscope.arm.motions.trajectory import ReferenceMotion, motion_of
from gapscope.arm.nominal import NominalArm
from gapscope.arm.root_mean_square import rms
from gapscope.arm.velocity_filter import VelocityFilter
from gapscope.envs.actions import (
    DAMPING,
    Gains,
    pd_gains,
    rated_torque,
    scaled,
    torque_limit,
)
from gapscope.envs.arguments import check_values
from gapscope.envs.environment import (
    EXTENSION,
    SUB_STEPS,
    TIME_STEP,
    Layout,
    steps_between_readings,
)
from gapscope.envs.position_controller import (
    VELOCITY_CUTOFF,
    VELOCITY_DAMPING,
    cutoff,
)
from gapscope.envs.reward import Reward
from gapscope.envs.simulated_arm import SimulatedArm, closed_loop, diverged
from gapscope.model.conditioning import torque_scale

# Controllers of a joint torque: PD with or without a model's feedforward, computed torque, and a trained agent.


@dataclass(frozen=True)
class Tuning:
    """How stiff a loop is to be.

    Attributes:
        bandwidth: w / 2 pi [Hz].
        damping: zeta [1].

    Raises:
        InputError: a number that is not above zero.
    """

    bandwidth: float = 4.0
    damping: float = DAMPING

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_values(vars(self), "environment", "evaluation")

    def gains(self, inertia: np.ndarray) -> Gains:
        """kp = w^2 M [N m/rad] and kd = 2 zeta w M [N m s/rad], each (n,), on inertias M [kg m^2], shape (n,)."""
        return pd_gains(inertia, self.bandwidth, self.damping)

    def times(self, factor: float) -> Tuning:
        """The same with the bandwidth multiplied: kp grows with the square of the factor, kd with the factor."""
        return Tuning(self.bandwidth * factor, self.damping)


class Feedforward:
    """tau = model(q_ref, dq_ref, ddq_ref) + kp (q_ref - q) + kd (dq_ref - dq), clipped at +-limit.

    It is called at every tick, and its torque is held until the next; other controllers are kinds of it.

    Without a model it is PD alone, with ``gapscope.agents.models.Gravity`` PD with gravity, with
    ``gapscope.agents.models.ArmModel`` PD with inverse dynamics. The model is outside the loop: it changes
    how well a reference is followed, hardly what gains are stable.

    Args:
        gains: kp [N m/rad], kd [N m s/rad], each (n,).
        limit: torque limit [N m], shape (n,); infinite for none.
        model: feedforward, or ``None``.
    """

    def __init__(
        self, gains: Gains, limit: np.ndarray, model: TorqueModel | None = None
    ) -> None:
        self.gains, self.limit, self.model = gains, limit, model

    def begin(self, motion: Motion) -> None:
        """Start anew on a reference, given at every tick; here nothing is to be reset."""

    def plan(self, motion: Motion) -> np.ndarray:
        """Feedforward of a reference known beforehand [N m], shape (N, n); zeros if it takes none."""
        if self.model is None:
            return np.zeros_like(motion.q)
        return self.model.series(motion)

    def __call__(self, now: Targets, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Torque to command [N m], shape (n,).

        Args:
            now: reference, and what ``plan`` has for this tick, each (n,).
            q, dq: position of the encoders [rad], velocity estimated from them [rad/s], each (n,).
        """
        tau = self.gains.kp * (now.q - q) + self.gains.kd * (now.dq - dq)
        tau += now.torque
        return np.minimum(np.maximum(tau, -self.limit), self.limit)


class ComputedTorque(Feedforward):
    """tau = model(q, dq_ref, ddq_ref + w^2 (q_ref - q) + 2 zeta w (dq_ref - dq)), clipped at +-limit.

    The model is inside the loop: its inertia scales the gains, so that a wrong one shifts the bandwidth. Coriolis
    torque and friction are taken at the reference's velocity; at the measured one dry friction would chatter. No delay
    is compensated, since the state of the arm is not known beforehand.

    Args:
        tuning: w and zeta.
        limit: torque limit [N m], shape (n,); infinite for none.
        model: inverse dynamics.

    Source: siciliano2009.
    """

    def __init__(self, tuning: Tuning, limit: np.ndarray, model: TorqueModel) -> None:
        # nothing is planned: the model is inside the loop
        super().__init__(tuning.gains(np.ones(len(limit))), limit)
        self.inside = model

    def __call__(self, now: Targets, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Torque to command [N m], shape (n,)."""
        # on an inertia of one the gains are w^2 and 2 zeta w
        stiffness, rate = self.gains
        wanted = now.ddq + stiffness * (now.q - q) + rate * (now.dq - dq)
        tau = self.inside(q, now.dq, wanted)
        return np.minimum(np.maximum(tau, -self.limit), self.limit)


class AgentController(Feedforward):
    """tau = model(q_ref, dq_ref, ddq_ref) + kp (q_ref - q) + kd (dq_ref - dq) + a, clipped at +-limit.

    The action a [N m] is chosen every ``agent.period`` and held, from what the environment would let the agent observe.
    An agent with actions of the kind ``scale`` multiplies feedforward and gains instead, one of the kind ``torque``
    commands all of the torque.

    Args:
        gains: kp [N m/rad], kd [N m s/rad], each (n,).
        limit: torque limit [N m], shape (n,); infinite for none.
        agent: the agent.
    """

    def __init__(self, gains: Gains, limit: np.ndarray, agent: AgentModel) -> None:
        super().__init__(gains, limit, agent.model)
        self.agent = agent
        self._layout = Layout(len(limit), agent.look_ahead, agent.control.size)

    def begin(self, motion: Motion) -> None:
        """Forget earlier actions; the reference at every tick follows."""
        self._reference, self._tick = motion.q, 0
        self._action = np.zeros(self.agent.control.size)
        self._every = max(1, round(self.agent.period * motion.rate))
        self._ahead = [round(time * motion.rate) for time in self.agent.look_ahead]
        tick = self.agent.period / self._every
        self._spaced = steps_between_readings(self.agent.control, tick, self._every)
        rate = 1.0 / (tick * self._spaced)
        how = rate, cutoff(rate), VELOCITY_DAMPING
        self._estimate = VelocityFilter(how, motion.q[0], motion.dq[0])
        self._velocity = motion.dq[0]

    def __call__(self, now: Targets, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Torque to command [N m], shape (n,); ``begin`` comes before the first tick."""
        control, planned = self.agent.control, now.torque
        # without a PD loop the environment differentiates the position, and reads it less often
        if control.gains is None:
            if self._tick and self._tick % self._spaced == 0:
                self._velocity = self._estimate(q)
            dq = self._velocity
        if self._tick % self._every == 0:
            # the end of the reference is held
            ahead = self._reference.take(
                [self._tick + steps for steps in self._ahead], axis=0, mode="clip"
            )
            # the order in which the environment lets an agent observe
            row = (now.q, now.dq, (ahead - now.q).ravel(), planned / control.rated)
            measured = (q, dq, now.q - q, self._action)
            chosen = self.agent.policy(
                self._layout.assemble(measured, np.concatenate(row))
            )
            # as the environment does with actions, in training and here
            self._action = np.clip(chosen, -1.0, 1.0)
        self._tick += 1
        error, rate, (kp, kd) = now.q - q, now.dq - dq, self.gains
        if control.multiplies:
            factor, (kp, kd) = scaled(self.gains, self._action)
            tau = factor * planned + kp * error + kd * rate
        elif control.kind == "torque":
            tau = control.scale * self._action
        else:
            tau = planned + kp * error + kd * rate + control.scale * self._action
        return np.minimum(np.maximum(tau, -self.limit), self.limit)


# Tracking: a simulated arm follows a reference, what a track is measured by, and whether the loop is stable.


class SampledReference(NamedTuple):
    """A reference at every tick of a controller, from some time before its start to beyond its end, N ticks.

    Attributes:
        motion: the reference; negative times hold its start [s], [rad], [rad/s], [rad/s^2].
        first: tick of t = 0.
        torque: feedforward of a controller at every tick [N m], shape (N, n); zeros at first.
    """

    motion: Motion
    first: int
    torque: np.ndarray

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
        ticks = np.arange(-first, round((duration + EXTENSION) / dt))
        motion = motion_of(reference, ticks * dt)
        return cls(motion, first, np.zeros_like(motion.q))

    def planned(self, controller: Feedforward) -> SampledReference:
        """The same with the feedforward of a controller."""
        return self._replace(torque=controller.plan(self.motion))

    @property
    def ticks(self) -> int:
        """Ticks that are tracked."""
        return len(self.motion.t) - round(EXTENSION * self.motion.rate)


class TrackingRun(NamedTuple):
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
    controller: Feedforward,
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
    # before t = 0: the arm settles under the loop until then
    simulated.start(motion.q[0], start_speed, float(motion.t[0]))
    error_rate = VelocityFilter(
        (1.0 / simulated.dt, cutoff, VELOCITY_DAMPING),
        np.zeros(n),
        # starts at the true rate of the error: a kick must not look like a step
        motion.dq[0] - start_speed,
    )
    series = (motion.q, motion.dq, motion.ddq, course.torque)
    targets = Targets(*series).at(slice(course.ticks))
    loop = closed_loop(
        simulated, targets, controller, lambda now, q: now.dq - error_rate(now.q - q)
    )
    q, tau = np.empty((2, course.ticks, n))
    done, ran_away = course.ticks, False
    for i, (q[i], _, tau[i]) in enumerate(loop):
        # the true speed: encoders would show it late
        if diverged(simulated.dq):
            done, ran_away = i, True
            break
    # settling does not count; an arm that diverged meanwhile leaves no row
    rows = slice(min(course.first, done), done)
    return TrackingRun(motion.t[rows], motion.q[rows], q[rows], tau[rows], ran_away)


class TrackingMetrics:
    """Measures the tracks of one arm, each as a mapping; what is an error is infinite if the arm diverged.

    - joint_error: RMS of q_ref - q of the encoders over time and joints [rad];
    - tool_error: RMS distance of the tool between both, by the kinematics [m];
    - reward: mean per action of the environment's reward, an action being the torque over the rated torque; what is
      missing because the arm diverged counts as 0 [1];
    - torque_rate: RMS over time and joints of the change of the commanded torque per tick [N m/s];
    - diverged: whether the arm diverged.

    Args:
        arm: the nominal arm.
        body: its rigid-body model.
        space: where it moves.
    """

    def __init__(self, arm: NominalArm, body: RigidBody, space: Workspace) -> None:
        self.limit = torque_limit(arm, body)
        self._rated = rated_torque(arm, body, space)
        self._kinematics = space.kinematics

    def __call__(
        self, track: TrackingRun, dt: float, duration: float
    ) -> dict[str, float]:
        """Measure a track with a period of ``dt`` [s] on a course of ``duration`` [s]."""
        # as long as those of the environment, for the reward and the tool's error
        every = max(1, round(TIME_STEP * SUB_STEPS / dt))
        actions = max(1, round(duration / dt) // every)
        # each action that was done, by the torque of the ticks before its end
        effort = track.tau / self._rated
        ends = np.arange(every, min(len(track.t), actions * every + 1), every)
        blocks = effort[: len(ends) * every].reshape(len(ends), every * effort.shape[1])
        # the first action has none before it: its jump is within itself
        jump = effort[ends - 1] - effort[np.maximum(ends - 1 - every, 0)]
        error = track.q_ref[ends] - track.q[ends]
        rewards = Reward()(error, np.mean(blocks**2, axis=1), jump).total
        # over all actions that were due: missing ones count as zero
        reward = float(rewards.sum()) / actions
        found = dict.fromkeys(("joint_error", "tool_error"), inf)
        found |= {"reward": reward, "torque_rate": inf, "diverged": track.diverged}
        if track.diverged:
            return found
        # the tool by the kinematics, once per action
        tool = self._kinematics.tool
        wanted, reached = (
            np.array([tool(q).translation for q in series[::every]])
            for series in (track.q_ref, track.q)
        )
        return found | {
            "joint_error": float(rms(track.q_ref - track.q, None)),
            "tool_error": float(
                np.sqrt(np.mean(np.square(wanted - reached).sum(axis=1)))
            ),
            "torque_rate": float(rms(np.diff(track.tau, axis=0) / dt, None)),
        }


KICK = 0.2
"""Velocity of all joints at the start of one of two runs [rad/s]."""
MAX_REMAINDER = 0.25
"""A loop is stable if less than this share of the kick is left at the end [1]."""
MAX_TORQUE_RATE = 10.0
"""An arm shakes if its torque changes so many times as fast as the motion needs [1]. Set by hand: arms that follow stay
below 2, those that shake between their torque limits are above 50 (``docs/feedforward.md``)."""
SPAN = 0.01
"""Time over which speeds and torque rates are taken, long beside a step of the encoders [s]."""
FACTORS = 2.0 ** np.arange(-4, 7)
"""Factors on the bandwidth between which the margin is sought [1]."""
HIGHEST = float(FACTORS[-1])
"""The largest of them."""
RESOLUTION = 0.02
"""The bisection ends when its interval is this narrow [1]."""


def settles(
    simulated: SimulatedArm,
    controller: Feedforward,
    course: SampledReference,
    needed: np.ndarray,
    cutoff: float | None = VELOCITY_CUTOFF,
) -> bool:
    """Whether an arm forgets a kick while it moves: two runs, one with a kick, come together again.

    Two runs of one course differ by the loop alone, whatever feedforward and tracking error. The difference of
    their speeds, RMS over the last third and largest over the joints, has to fall below ``MAX_REMAINDER`` of the kick.
    Two arms that shake between their torque limits may fall into step: their torque rate tells them. How well the arm
    tracks does not count. Arms without noise only.

    Args:
        simulated: the arm.
        controller: with its feedforward, if it has one, in ``course``.
        course: what is tracked.
        needed: torque that the arm needs on the course [N m], shape (N, n).
        cutoff: of the velocity's differentiator [Hz]; a backward difference if ``None``.
    """
    calm = track(simulated, controller, course, cutoff=cutoff)
    kicked = track(simulated, controller, course, kick=KICK, cutoff=cutoff)
    if calm.diverged or kicked.diverged:
        return False
    ticks = max(1, round(SPAN / simulated.dt))

    def final_rate(series: np.ndarray) -> np.ndarray:
        # over ``SPAN``: one step of an encoder would be a large speed
        rate = (series[ticks:] - series[:-ticks]) / (ticks * simulated.dt)
        # over the last third
        return rms(rate[-len(rate) // 3 :])

    forgotten = final_rate(kicked.q - calm.q).max() < MAX_REMAINDER * KICK
    usual = np.diff(needed[::ticks], axis=0) / (ticks * simulated.dt)
    # the scale of a healthy change, per joint, small joints not below a share of all
    allowed = MAX_TORQUE_RATE * torque_scale(usual)
    # two arms that shake in step differ by nothing: each is looked at alone
    shakes = any((final_rate(run.tau) > allowed).any() for run in (calm, kicked))
    return bool(forgotten and not shakes)


def largest_factor(stable: Callable[[float], bool]) -> float:
    """Largest factor f for which ``stable(f)`` holds, by halving or doubling from 1 and then bisection of log f.

    A loop that is stable at f is assumed stable below, down to the first stable one: gains may be too small to hold
    the arm. Sought within ``FACTORS``, whose largest is returned if it is stable; 0 if nothing is.
    """
    # from 1 downward, and only then upward
    order = sorted(FACTORS.tolist(), key=lambda f: (f > 1, abs(np.log2(f))))
    low = next((factor for factor in order if stable(factor)), 0.0)
    # below 1 the doubled factor was tried on the way down, and is not stable
    high = 2 * low
    if low >= 1.0:
        while low < HIGHEST and stable(high):
            low, high = high, 2 * high
    if low in (0.0, HIGHEST):
        return low
    while high / low > 1 + RESOLUTION:
        # the middle on a logarithmic scale, as bandwidths differ by factors
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low
