"""Controllers: values worked out by hand on a pendulum, limits, and how well inverse dynamics tracks."""

from dataclasses import replace

import numpy as np
import pytest

from gapscope.agents.controllers import (
    ComputedTorque,
    Feedforward,
    Tuning,
    gains,
    own_inertia,
)
from gapscope.agents.evaluation import EvaluationPlan, TrackingBench
from gapscope.agents.models import ArmModel, Gravity
from gapscope.agents.tracking import SampledReference, track
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.named_motions import draw_motion, workspace
from gapscope.arm.nominal import NominalArm
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.mystery_arm import iiwa
from gapscope.envs.simulated_arm import SimulatedArm

UNLIMITED = np.array([np.inf])
NOW = tuple(np.array([x]) for x in (0.3, 0.2, 0.5, 0.1, -0.1))
"""q_ref, dq_ref, ddq_ref, q, dq of the pendulum."""
TUNING = Tuning(1.0, 0.5)
W = 2 * np.pi


def test_gains_of_the_pendulum(pendulum: NominalArm) -> None:
    inertia = own_inertia(pendulum, np.zeros(1))
    assert inertia == pytest.approx([2 * 0.5**2 + 0.1 + 0.4])  # 1 kg m^2
    kp, kd = gains(inertia, TUNING)
    assert kp == pytest.approx([W**2]) and kd == pytest.approx(
        [W]
    )  # 2 zeta w M with zeta = 1/2
    doubled = gains(inertia, TUNING.times(2.0))
    assert doubled.kp == pytest.approx(4 * kp) and doubled.kd == pytest.approx(2 * kd)


def test_pd_by_hand(pendulum: NominalArm) -> None:
    controller = Feedforward(gains(np.ones(1), TUNING), UNLIMITED)
    assert controller.torque(*NOW) == pytest.approx([W**2 * 0.2 + W * 0.3])


def test_pd_with_gravity_by_hand(pendulum: NominalArm) -> None:
    """The height of the mass is -0.5 sin q: gravity takes -2 * 9.81 * 0.5 cos q_ref."""
    controller = Feedforward(gains(np.ones(1), TUNING), UNLIMITED, Gravity(pendulum))
    expected = W**2 * 0.2 + W * 0.3 - 9.81 * np.cos(0.3)
    assert controller.torque(*NOW) == pytest.approx([expected])


def test_pd_with_inverse_dynamics_by_hand(pendulum: NominalArm) -> None:
    controller = Feedforward(
        gains(np.ones(1), TUNING), UNLIMITED, ArmModel(CorrectedArm(pendulum))
    )
    expected = W**2 * 0.2 + W * 0.3 - 9.81 * np.cos(0.3) + 1.0 * 0.5
    assert controller.torque(*NOW) == pytest.approx([expected])
    assert controller.torque(*NOW, planned=np.array([7.0])) == pytest.approx(
        [W**2 * 0.2 + W * 0.3 + 7.0]
    )


def test_computed_torque_by_hand(pendulum: NominalArm) -> None:
    """Gravity at the measured position, 1 kg m^2 times the acceleration that is asked for."""
    controller = ComputedTorque(TUNING, UNLIMITED, ArmModel(CorrectedArm(pendulum)))
    expected = 1.0 * (0.5 + W**2 * 0.2 + W * 0.3) - 9.81 * np.cos(0.1)
    assert controller.torque(*NOW) == pytest.approx([expected])
    assert controller.plan is not None


@pytest.mark.parametrize("limit", [1.0, 8.0])
def test_torque_is_clipped(pendulum: NominalArm, limit: float) -> None:
    model = ArmModel(CorrectedArm(pendulum))
    for controller in (
        Feedforward(gains(np.ones(1), TUNING), np.array([limit]), model),
        ComputedTorque(TUNING, np.array([limit]), model),
    ):
        far = (NOW[0] + 9, *NOW[1:])
        assert controller.torque(*far) == pytest.approx([limit])


@pytest.mark.parametrize(
    "bad", [{"bandwidth": 0.0}, {"bandwidth": float("nan")}, {"damping": -1.0}]
)
def test_bad_tuning_is_refused(bad: dict) -> None:
    with pytest.raises(InputError, match="above zero"):
        Tuning(**bad)


@pytest.mark.parametrize("computed", [False, True])
def test_inverse_dynamics_tracks_an_arm_without_effects_within_a_milliradian(
    computed: bool,
) -> None:
    """Without dry friction, which no smooth feedforward meets where a joint turns round."""
    arm = replace(iiwa(), coulomb=np.zeros(7))
    body = RigidBody(arm)
    space = workspace(body)
    model, tuning = ArmModel(CorrectedArm(arm)), Tuning(4.0)
    limit = np.asarray(arm.torque_limit)
    controller = (
        ComputedTorque(tuning, limit, model)
        if computed
        else Feedforward(gains(own_inertia(arm, space.posture), tuning), limit, model)
    )
    course = SampledReference.of(
        draw_motion("fourier", np.random.default_rng(5), space, 2.0), 2.0, 1e-3
    ).planned(controller)
    with SimulatedArm(arm, encoder_step=arm.encoder_step) as simulated:
        done = track(simulated, controller, course)
    assert not done.diverged and len(done.t) == 2000 and done.t[0] == pytest.approx(0.0)
    assert np.abs(course.motion.q - course.motion.q[0]).max() > 0.3
    assert np.abs(done.q - done.q_ref).max() < 2e-4


def test_dry_friction_leaves_less_than_a_milliradian() -> None:
    """RMS of each joint, data-sheet friction of up to 3.5 N m included."""
    arm = iiwa()
    bench = TrackingBench(arm, (), EvaluationPlan(duration=2.0))
    controller = bench.controller(ArmModel(CorrectedArm(arm)))
    course = bench.course("fourier", 0)[0].planned(controller)
    with SimulatedArm(arm, encoder_step=arm.encoder_step) as simulated:
        done = track(simulated, controller, course)
    assert np.sqrt(np.mean((done.q - done.q_ref) ** 2, axis=0)).max() < 1e-3
