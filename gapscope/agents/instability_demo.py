"""An arm that shakes: plausible gains, a wrong model, and feedforward switched on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.agents.controllers import (
    ComputedTorque,
    Feedforward,
    TrackingController,
    Tuning,
    gains,
    own_inertia,
)
from gapscope.agents.evaluation import DT
from gapscope.agents.models import ArmModel
from gapscope.agents.tracking import Measures, SampledReference, TrackingMetrics, track
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.named_motions import draw_motion, workspace
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect, carried, drives_with
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.simulated_arm import SimulatedArm

DELAY = 8e-3
"""Delay of the drives of the true arm [s]."""
ROTORS, LOAD = 3.0, 0.9
"""The wrong model believes the rotors to be so many times what they are [1], and the arm to carry this share of what
it may carry [1]."""
CASES = (
    "pd",
    "feedforward, right model",
    "feedforward, wrong model",
    "computed, right model",
    "computed, wrong model",
)
"""What ``run_instability_demo`` compares: the model outside the loop, and inside it."""


@dataclass(frozen=True)
class InstabilityDemo:
    """One of ``CASES``, and what came of it."""

    case: str
    measures: Measures


def run_instability_demo(
    arm: NominalArm,
    bandwidth: float = 5.0,
    engine: str | None = None,
    duration: float = 2.0,
) -> list[InstabilityDemo]:
    """Track one motion with each of ``CASES`` at the same gains.

    The true arm is the nominal one but for a delay of ``DELAY`` on every joint; the wrong model has too much inertia.
    As feedforward it costs accuracy. In computed torque it multiplies the gains by its inertia over the true one: the
    bandwidth leaves what the delay allows, and the arm shakes between its torque limits.

    Args:
        arm: the nominal arm; rotors and torque limits in its data sheet.
        bandwidth: of the loop [Hz], with a damping ratio of 0.7.
        engine: that simulates it.
        duration: of the motion [s].
    """
    body, tuning = RigidBody(arm), Tuning(bandwidth)
    space = workspace(body)
    metrics = TrackingMetrics(arm, body, space)
    delay, wrong = _true_and_wrong(arm)
    models = [ArmModel(CorrectedArm(arm, effects)) for effects in (delay, wrong)]
    loop = gains(own_inertia(arm, space.posture), tuning)
    limit = metrics.limit
    controllers: list[TrackingController] = [Feedforward(loop, limit)]
    controllers += [Feedforward(loop, limit, model) for model in models]
    controllers += [ComputedTorque(tuning, limit, model) for model in models]
    reference = draw_motion("fourier", np.random.default_rng(0), space, duration)
    course = SampledReference.of(reference, duration, DT)
    out = []
    with SimulatedArm(
        arm, delay, DT, engine=engine, encoder_step=arm.encoder_step or 0.0
    ) as simulated:
        for case, controller in zip(CASES, controllers, strict=True):
            run = track(simulated, controller, course.planned(controller))
            out.append(InstabilityDemo(case, metrics(run, DT, duration)))
    return out


def _true_and_wrong(
    arm: NominalArm,
) -> tuple[tuple[AppliedEffect, ...], tuple[AppliedEffect, ...]]:
    """Effects of the true arm, a delay, and of the wrong model, which has too much inertia besides."""
    joints = tuple(range(1, arm.n_joints + 1))
    delay = drives_with(joints, delay=np.full(arm.n_joints, DELAY))
    rotors = drives_with(joints, rotor=(ROTORS - 1) * arm.armature)
    load = carried(LOAD * ArmScale.of(arm).lift, (0.0, 0.0, 0.1))
    return (delay,), (rotors, load, delay)
