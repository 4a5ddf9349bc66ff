"""The recorder: a simulated arm with effects follows references under its controller, and is recorded.

A session does several motions, slow and fast, and becomes a case.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.control import SETTLE, ControlLoop, Targets, like_pd
from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.dynamics.rollout import steps_per_tick
from gapscope.arm.errors import GapscopeError, InputError, ModelWarning
from gapscope.arm.io.plausibility import SHORTEST_LOG
from gapscope.arm.motions.named_motions import (
    Workspace,
    check_motion_name,
    draw_motion,
    workspace,
)
from gapscope.arm.motions.trajectory import (
    ReferenceMotion,
    Sampled,
    check_sample_count,
    motion_of,
    read_sampled,
)
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.velocity_filter import VelocityFilter, filter_gains
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Path as TorquePath
from gapscope.envs.actions import DAMPING
from gapscope.envs.arguments import check_values
from gapscope.envs.engines import check_engine, default_engine
from gapscope.envs.position_controller import SAFE, SampledLoop, position_controller
from gapscope.envs.simulated_arm import SimulatedArm, closed_loop, diverged, fastest
from gapscope.model.conditioning import torque_scale

RECENT_TICKS, POSTURE_TICKS = 1000, 50
"""Ticks before a divergence from which the postures are taken that may explain it, and from one to the next."""


def record(
    arm: NominalArm,
    effects: tuple[AppliedEffect, ...],
    reference: ReferenceMotion,
    controller: Controller,
    *,
    duration: float,
    rng: np.random.Generator,
    rate: float = 250.0,
    encoder_step: float | None = None,
    encoder_noise: np.ndarray | float = 0.0,
    torque_noise: np.ndarray | float = 0.0,
    read_back: bool = False,
    name: str = "recording",
    engine: str | None = None,
    later: tuple[float, tuple[AppliedEffect, ...]] | None = None,
) -> Recording:
    """Record a simulated arm; columns t, q, dq (filtered), tau (commanded), q_ref and dq_ref.

    At each tick of the controller its torque, clipped at the torque limit, is computed from the quantised encoders and
    held until the next tick. Row i holds the encoders' positions at t[i]
    and the torque commanded at t[i]. A reference that starts at rest is held for ``SETTLE`` before t = 0, so
    that the arm rests where its effects let it rest; one that starts in motion is met in motion. An integrator starts
    at zero.

    Args:
        arm: the nominal arm, which is also what the feedforward believes.
        effects: what the simulated arm has beyond it.
        reference: the motion to follow.
        controller: its rate [Hz] is a multiple of ``rate``.
        duration: of the recording [s].
        rng: source of the noise.
        rate: of the recording [Hz].
        encoder_step: quantisation of the encoders [rad]; that of the data sheet if ``None``, none if 0.
        encoder_noise: standard deviation of white noise on the encoders [rad], a number or shape (n,).
        torque_noise: standard deviation of white noise on the recorded torque [N m], a number or shape (n,).
        read_back: record the torque that reached the joints, as position control reads it back from its drives, instead
            of the one commanded; row i holds what is applied from t[i] on.
        name: name of the recording.
        engine: ``pybullet`` or ``mujoco``; by default PyBullet if it is installed, else MuJoCo.
        later: a time [s], and the effects that take the place of the others from then on, as when a payload is picked
            up; position and velocity of the joints continue, states of effects are reset.

    Raises:
        InputError: ``rate`` does not divide the controller's rate, or an effect cannot be simulated on this arm.
        GapscopeError: the simulated arm diverged; says why.
    """
    # rates with decimals are whole multiples but for rounding
    every = round(controller.rate / rate)
    if abs(every * rate - controller.rate) > 1e-6 * rate:
        near = controller.rate / max(1, every)
        raise InputError(
            f"{rate:g} Hz does not divide the controller's {controller.rate:g} Hz",
            f"record at {near:g} Hz, or another whole part of the controller's rate",
            where="rate",
        )
    # one that starts in motion cannot be held before its start
    rests = np.abs(reference.velocity(np.zeros(1))).max() < 1e-9
    first = round(SETTLE * controller.rate) if rests else 0
    t = np.arange(-first, round(duration * controller.rate) + 1) / controller.rate
    motion = motion_of(reference, t)
    targets = Targets.of(arm, controller, motion.q, motion.dq, motion.ddq)
    # the arm itself is unknown to its controller, which believes the nominal one
    control = ControlLoop(controller, arm)
    filtered = VelocityFilter(
        controller.estimate,
        targets.q[0],
        targets.dq[0],
    )
    steps = steps_per_tick(controller)
    if encoder_step is None:
        encoder_step = arm.encoder_step or 0.0
    change, following = later or (np.inf, effects)
    q, dq, tau = np.empty((3, *targets.q.shape))
    with SimulatedArm(
        arm,
        effects,
        1.0 / (controller.rate * steps),
        engine=engine,
        encoder_step=encoder_step,
        encoder_noise=encoder_noise,
        rng=rng,
    ) as simulated:
        # drift and forces count from the first row: the rest lies before it
        simulated.start(targets.q[0], targets.dq[0], t[0])
        loop = closed_loop(
            simulated, targets, control, lambda _, at: filtered(at), steps
        )
        for i, (q[i], dq[i], tau[i]) in enumerate(loop):
            if diverged(simulated.dq):
                # backwards from the divergence
                recent = targets.q[max(0, i - RECENT_TICKS) : i + 1][::-POSTURE_TICKS]
                at_work, speed = simulated.effects[0], simulated.dq
                raise _diverged(arm, at_work, controller, recent, speed, float(t[i]))
            # the torque of this tick has been held: what arrived is told in its row
            if read_back:
                tau[i] = simulated.applied
            # at the first tick from that time on
            if i + 1 < len(t) and t[i] < change <= t[i + 1]:
                simulated.become(following, t[i + 1])
    # from t = 0 on, a row for every so many ticks
    rows = np.arange(first, len(t), every)
    noise = rng.standard_normal((len(rows), arm.n_joints)) * torque_noise
    return Recording(
        name,
        t[rows],
        q[rows],
        tau[rows] + noise,
        dq=dq[rows],
        q_ref=targets.q[rows],
        dq_ref=targets.dq[rows],
    )


def _diverged(
    arm: NominalArm,
    effects: tuple[AppliedEffect, ...],
    controller: Controller,
    postures: np.ndarray,
    speed: np.ndarray,
    time: float,
) -> GapscopeError:
    """The error that says at which joint and when the arm diverged, and what lets it.

    Args:
        arm: the nominal arm.
        effects: what the simulated arm had beyond it.
        controller: its controller.
        postures: references before the divergence [rad], shape (K, n).
        speed: of the joints [rad/s], shape (n,).
        time: since the start of the recording [s].
    """
    joint, causes = fastest(speed), []
    estimate = filter_gains(*controller.estimate)
    loop = SampledLoop(controller, 1.0 / controller.rate, estimate)
    # first without effects: gains that even the nominal arm does not bear are enough
    share = _stable_share(loop, CorrectedArm(arm), postures)
    if share < 1.0:
        lower = _lower(controller, share)
        causes.append(f"the controller's gains are too large for this arm: {lower}")
    elif effects:
        true = CorrectedArm(arm, effects)
        names = ", ".join(dict.fromkeys(effect.name for effect in effects))
        # the longest delay of any joint, taken for all: the loop has one
        delay = float(np.max(true.quantity("delay")))
        late = loop._replace(late=round(delay / loop.dt))
        share = _stable_share(late, true, postures)
        causes.append(
            f"{names} makes a stable loop unstable: milder effects, or {_lower(controller, share)}"
            if share < 1.0
            else f"the loop is stable without {names}: milder effects, or lower gains of the controller"
        )
    # whatever the cause, a torque without bounds lets it grow
    if arm.torque_limit is None:
        causes.append("nothing limits the torque: give torque_limit in the data sheet")
    if arm.viscous[joint] == 0 and arm.armature[joint] == 0:
        causes.append(
            f"joint {joint + 1} has neither friction nor a rotor: give viscous and armature in the data sheet"
        )
    return GapscopeError(
        f"the simulated arm diverged at joint {joint + 1}, at t = {time:.3g} s",
        "; ".join(causes) or "lower the controller's gains",
    )


def _stable_share(loop: SampledLoop, arm: CorrectedArm, postures: np.ndarray) -> float:
    """Largest share of the loop's bandwidth that is stable at all postures [1]; 1 if the loop is."""
    nominal, body = arm.arm, RigidBody(arm.arm)
    own, rotors = np.diag(nominal.armature), np.diag(arm.quantity("rotor"))
    masses = [arm.body(body).mass_matrix(q) + rotors for q in postures]
    believed = [body.mass_matrix(q) + own for q in postures]
    return loop.stable_share(masses, nominal.viscous, believed)


def _lower(controller: Controller, share: float) -> str:
    """How much lower the gains must be."""
    names = [gain.name for gain in controller.gains]
    if share == 0.0:
        return f"no lower gains of this ratio are stable; check {', '.join(names)}, rate and velocity_filter"
    share *= SAFE
    factors = [f"{gain.name} by {share**gain.order:.2g}" for gain in controller.gains]
    return f"multiply {' and '.join(factors)}, half the stability limit"


SLOWEST = 0.4
"""Speed of the slowest recording over that of the fastest, which is what the limits allow [1]."""
POSTURE_PERIOD = 0.05
"""Time between the postures at which gains are checked [s]; a joint at 1.5 rad/s turns by 4 degrees in it."""


@dataclass(frozen=True)
class Plan:
    """How a session records.

    Attributes:
        motion: kind of motion, one of ``gapscope.arm.motions.named_motions.MOTIONS``, ``random``, or a CSV with
            references, which have their own duration.
        recordings: how many, the first the slowest.
        duration: of each [s].
        rate: sampling rate [Hz], which divides the controller's.
        read_back: record the torque that reached the joints, as it is read back from the drives of an arm under
            position control; otherwise the torque recorded is the one that the controller commands.
        noise: standard deviation of the recorded torque's noise over that of the joint's torque [1].
        encoder_noise: standard deviation of the encoders' noise [rad].
        engine: ``pybullet`` or ``mujoco``.

    Raises:
        InputError: a number that is not above zero, a duration shorter than a case may hold, or no such engine.
    """

    motion: str = "fourier"
    recordings: int = 4
    duration: float = 10.0
    rate: float = 250.0
    read_back: bool = False
    noise: float = 0.01
    encoder_noise: float = 0.0
    engine: str = field(default_factory=default_engine)

    def __post_init__(self) -> None:
        """Check the numbers and the engine."""
        check_engine(self.engine)
        check_values(vars(self), "environment", "recording")
        if self.duration < SHORTEST_LOG:
            raise InputError(
                f"a case holds recordings of at least {SHORTEST_LOG:g} s",
                where="duration",
            )
        check_sample_count(self.duration, self.rate, self.recordings)


def record_case(
    name: str,
    arm: NominalArm,
    effects: tuple[AppliedEffect, ...],
    plan: Plan,
    rng: np.random.Generator,
    *,
    controller: Controller | str = "pd",
    progress: Callable[[str], None] = lambda message: None,
) -> Case:
    """Record a simulated arm with effects; the case contains the nominal arm and the controller, not the effects.

    Args:
        name: name of the case.
        arm: the nominal arm.
        effects: what the simulated arm has beyond it.
        plan: how to record.
        rng: source of motions and noise.
        controller: or a control law, for gains that fit the arm and its motions; feedforward is nominal.
        progress: called with a few words before each recording.

    Raises:
        InputError: the plan does not fit the arm or the controller, or an effect cannot be simulated.
        GapscopeError: the simulated arm diverged; says why.
    """
    CorrectedArm(arm, effects).check()
    body = RigidBody(arm)
    space, (lower, upper) = workspace(body), body.position_limits()
    motions = _motions(arm, plan, rng, space)
    # a file has references of its own length
    durations = [
        motion.duration if isinstance(motion, Sampled) else plan.duration
        for motion in motions
    ]
    if isinstance(controller, str):
        # gains are to be stable wherever the motions go
        along = [
            motion.position(np.arange(0.0, duration, POSTURE_PERIOD))
            for motion, duration in zip(motions, durations, strict=True)
        ]
        pd = position_controller(arm, space.posture, along=np.vstack(along))
        controller = like_pd(pd, controller, DAMPING)
    recordings = []
    for i, motion in enumerate(motions):
        progress(f"records {i + 1} of {plan.recordings}")
        recording = record(
            arm,
            effects,
            motion,
            controller,
            duration=durations[i],
            rng=rng,
            rate=plan.rate,
            encoder_noise=plan.encoder_noise,
            read_back=plan.read_back,
            name=f"recording_{i + 1}",
            engine=plan.engine,
        )
        assert recording.tau is not None
        # motions keep a distance from the stops: gains or effects let joints come to them
        stopped = ((recording.q <= lower) | (recording.q >= upper)).any(axis=0)
        if stopped.any():
            joints = [f"{j + 1} ({arm.joints[j]})" for j in np.flatnonzero(stopped)]
            warnings.warn(
                f"{recording.name}: the controller did not hold joints {', '.join(joints)} off their stops, whose "
                "torque is in the recorded one. Give rotor inertias (nominal: armature), which allow for stiffer "
                "gains, or weaker effects",
                ModelWarning,
                stacklevel=2,
            )
        # a joint that hardly carries anything has noise all the same
        tau, size = recording.tau, plan.noise * torque_scale(recording.tau)
        noise = size * rng.standard_normal(tau.shape)
        recordings.append(replace(recording, tau=tau + noise))
    return Case(name, Path(), arm, tuple(recordings), controller=controller)


def hidden_by_reading_back(effects: tuple[AppliedEffect, ...]) -> tuple[str, ...]:
    """Names of effects between command and joint: torque that is read back behind them does not show them."""
    return tuple(
        applied.name for applied in effects if isinstance(applied.effect, TorquePath)
    )


def _motions(
    arm: NominalArm, plan: Plan, rng: np.random.Generator, space: Workspace
) -> list[ReferenceMotion]:
    """A motion for each recording, from slow to as fast as the limits allow, or as the file of a motion has it."""
    slowest = SLOWEST if plan.recordings > 1 else 1.0
    # from slow to fast: friction laws differ by velocity, inertia by acceleration
    speeds = np.linspace(slowest, 1.0, plan.recordings)
    if plan.motion.endswith(".csv"):
        sampled = read_sampled(Path(plan.motion), arm.n_joints)
        return [sampled.slower(speed) for speed in speeds]
    check_motion_name(plan.motion, arm.n_joints)
    motions = []
    for speed in speeds:
        limits = space.limits
        slower = limits._replace(
            velocity=speed * limits.velocity,
            # the same way in a longer time: acceleration goes with the square
            acceleration=speed**2 * limits.acceleration,
        )
        motions.append(
            draw_motion(plan.motion, rng, space._replace(limits=slower), plan.duration)
        )
    return motions
