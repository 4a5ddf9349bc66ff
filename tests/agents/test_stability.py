"""The gain margin by bisection, against a limit in closed form; and the arm that shakes."""

from dataclasses import replace

import numpy as np
import pytest

from gapscope.agents.evaluation import LAWS, EvaluationPlan, TrackingBench
from gapscope.agents.models import ArmModel
from gapscope.agents.tracking import (
    Feedforward,
    SampledReference,
    Tuning,
    largest_factor,
    settles,
    track,
)
from gapscope.arm.motions.trajectory import point_to_point
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect, carried
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.mystery_arm import iiwa
from gapscope.envs.simulated_arm import SimulatedArm

DT = 1e-3


def course_to(goal: np.ndarray, duration: float) -> SampledReference:
    """From zero to a posture within a second."""
    motion = point_to_point(np.zeros_like(goal), goal, 1.0)
    return SampledReference.of(motion, duration, DT, settle=0.0)


def test_margin_of_a_joint_with_a_delay(pendulum: NominalArm) -> None:
    """L(s) = (w^2 + 2 zeta w s) exp(-s T) / s^2 has |L| = 1 at W = w sqrt(2 zeta^2 + sqrt(4 zeta^4 + 1)).

    Without gravity its limit is W T = atan(2 zeta W / w). To the delay come half a tick, for which the torque is held
    on average, and half a tick of the backward difference.
    """
    zeta, delay = 0.7, 0.02
    ratio = np.sqrt(2 * zeta**2 + np.sqrt(4 * zeta**4 + 1))
    limit = np.arctan(2 * zeta * ratio) / ratio / (delay + DT) / (2 * np.pi)
    effects = (AppliedEffect("actuator_delay", (1,), {"delay": [delay]}),)
    course, free = course_to(np.full(1, 0.3), 2.0), np.full(1, np.inf)
    floating = replace(pendulum, gravity=np.zeros(3))
    with SimulatedArm(floating, effects, DT) as simulated:

        def stable(factor: float) -> bool:
            controller = Feedforward(Tuning(factor, zeta).gains(np.ones(1)), free)
            return settles(simulated, controller, course, course.motion.ddq, None)

        assert largest_factor(stable) == pytest.approx(limit, rel=0.05)


@pytest.mark.parametrize(("bandwidth", "stable"), [(2.0, True), (20.0, False)])
def test_shaking_between_the_limits_is_told_by_the_torque(
    two: NominalArm, bandwidth: float, stable: bool
) -> None:
    """The limits keep the arm from diverging; without feedforward it tracks badly either way, which does not count."""
    delay = AppliedEffect("actuator_delay", (1, 2), {"delay": [0.02, 0.02]})
    course = course_to(np.full(2, 0.5), 1.5)
    needed = ArmModel(CorrectedArm(two)).series(course.motion)
    loop = Tuning(bandwidth).gains(np.array([2.5, 1.0]))
    controller = Feedforward(loop, two.torque_limit)
    with SimulatedArm(two, (delay,), DT) as simulated:
        assert settles(simulated, controller, course, needed) == stable
        assert stable or not track(simulated, controller, course).diverged


@pytest.mark.slow
def test_an_arm_with_a_wrong_model_inside_the_loop_shakes() -> None:
    """Drives that are late, and a model with too much inertia: outside the loop it only costs accuracy."""
    arm, joints = iiwa(), tuple(range(1, 8))
    late = AppliedEffect("actuator_delay", joints, {"delay": np.full(7, 8e-3)})
    rotors = AppliedEffect("armature", joints, {"inertia": 2.0 * arm.armature})
    wrong = ArmModel(CorrectedArm(arm, (rotors, carried(12.0, (0.0, 0.0, 0.1)), late)))
    models = {"right": ArmModel(CorrectedArm(arm, (late,))), "wrong": wrong}
    found = {}
    for law in LAWS:
        plan = EvaluationPlan(("fourier",), ("none",), (0,), ("pybullet",), 2.0)
        plan = replace(plan, law=law, tuning=Tuning(5.0))
        bench = TrackingBench(arm, (late,), plan)
        for name, model in models.items():
            (found[law, name],) = bench.episodes(name, model, "pybullet", 0)
    inside = found["computed", "wrong"]
    assert found["computed", "right"]["joint_error"] < 1e-3
    assert inside["joint_error"] > 0.01
    assert inside["torque_rate"] > 50 * found["computed", "right"]["torque_rate"]
    outside, right = (found["feedforward", name] for name in ("wrong", "right"))
    assert right["joint_error"] < 1e-3 < outside["joint_error"]
    assert outside["torque_rate"] < 2 * right["torque_rate"]
