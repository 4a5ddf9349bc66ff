"""A session of recording: a simulated arm with effects does several motions, slow and fast, and becomes a case."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gapscope.arm.case import SHORTEST, Case
from gapscope.arm.control.laws import like_pd
from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.motions.named_motions import (
    Workspace,
    check_motion_name,
    draw_motion,
    workspace,
)
from gapscope.arm.motions.sample_count import check_sample_count
from gapscope.arm.motions.sampled import Sampled, read_sampled
from gapscope.arm.motions.trajectory import ReferenceMotion
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Path as TorquePath
from gapscope.envs.actions import DAMPING
from gapscope.envs.arguments import positive, whole
from gapscope.envs.engines import check_engine, default_engine
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import record

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
        engine: ``pybullet``, ``mujoco`` or ``dart``.

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
        whole("recordings", self.recordings)
        positive("rate", self.rate, "Hz")
        if positive("duration", self.duration, "s") < SHORTEST:
            raise InputError(
                f"a case holds recordings of at least {SHORTEST:g} s", where="duration"
            )
        check_sample_count(self.duration, self.rate, self.recordings)
        for name in ("noise", "encoder_noise"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise InputError(
                    f"expected a number from 0 on, got {getattr(self, name)!r}",
                    where=name,
                )


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
    space = workspace(RigidBody(arm))
    motions = _motions(arm, plan, rng, space)
    if isinstance(controller, str):
        along = np.vstack([_postures(motion, plan.duration) for motion in motions])
        pd = position_controller(arm, space.posture, along=along)
        controller = like_pd(pd, controller, DAMPING)
    recordings = []
    for i, motion in enumerate(motions):
        progress(f"records {i + 1} of {plan.recordings}")
        recording = record(
            arm,
            effects,
            motion,
            controller,
            duration=motion.duration if isinstance(motion, Sampled) else plan.duration,
            rng=rng,
            rate=plan.rate,
            encoder_noise=plan.encoder_noise,
            read_back=plan.read_back,
            name=f"recording_{i + 1}",
            engine=plan.engine,
        )
        assert recording.tau is not None
        _warn_of_stops(recording, arm)
        spread = recording.tau.std(axis=0)
        noise = (
            plan.noise
            * np.maximum(spread, 0.05 * spread.max())
            * rng.standard_normal(recording.tau.shape)
        )
        recordings.append(replace(recording, tau=recording.tau + noise))
    return Case(name, Path(), arm, tuple(recordings), controller=controller)


def hidden_by_reading_back(effects: tuple[AppliedEffect, ...]) -> tuple[str, ...]:
    """Names of effects between command and joint: torque that is read back behind them does not show them."""
    return tuple(
        applied.name for applied in effects if isinstance(applied.effect, TorquePath)
    )


def _warn_of_stops(recording: Recording, arm: NominalArm) -> None:
    """Warn of joints that came to their stops, from which motions keep a distance, as gains or effects let them."""
    lower, upper = RigidBody(arm).position_limits()
    stopped = ((recording.q <= lower) | (recording.q >= upper)).any(axis=0)
    if not stopped.any():
        return
    joints = ", ".join(f"{j + 1} ({arm.joints[j]})" for j in np.flatnonzero(stopped))
    warnings.warn(
        f"{recording.name}: the controller did not hold joints {joints} off their stops, whose torque is in the "
        "recorded one. Give rotor inertias (nominal: armature), which allow for stiffer gains, or weaker effects",
        ModelWarning,
        stacklevel=3,
    )


def _postures(motion: ReferenceMotion, duration: float) -> np.ndarray:
    """Postures that a motion passes [rad], every ``POSTURE_PERIOD``, shape (K, n)."""
    if isinstance(motion, Sampled):
        duration = motion.duration
    return motion.position(np.arange(0.0, duration, POSTURE_PERIOD))


def _motions(
    arm: NominalArm, plan: Plan, rng: np.random.Generator, space: Workspace
) -> list[ReferenceMotion]:
    """A motion for each recording, from slow to as fast as the limits allow, or as the file of a motion has it."""
    speeds = (
        np.linspace(SLOWEST, 1.0, plan.recordings)
        if plan.recordings > 1
        else np.ones(1)
    )
    if plan.motion.endswith(".csv"):
        sampled = read_sampled(Path(plan.motion), arm.n_joints)
        return [sampled.slower(speed) for speed in speeds]
    check_motion_name(plan.motion, arm.n_joints)
    motions: list[ReferenceMotion] = []
    for speed in speeds:
        limits = space.limits
        slower = limits._replace(
            velocity=speed * limits.velocity,
            acceleration=speed**2 * limits.acceleration,
        )
        motions.append(
            draw_motion(plan.motion, rng, space._replace(limits=slower), plan.duration)
        )
    return motions
