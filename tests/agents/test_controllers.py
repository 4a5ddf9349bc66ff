"""Controllers: values worked out by hand on a pendulum, limits, and how well inverse dynamics tracks."""

from dataclasses import replace

import numpy as np
import pytest

from gapscope.agents.models import ArmModel, Gravity
from gapscope.agents.tracking import (
    ComputedTorque,
    Feedforward,
    SampledReference,
    Tuning,
    track,
)
from gapscope.arm.control import Targets
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.named_motions import draw_motion, workspace
from gapscope.arm.nominal import NominalArm
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.mystery_arm import iiwa
from gapscope.envs.simulated_arm import SimulatedArm

UNLIMITED = np.array([np.inf])
Q, DQ = np.array([0.1]), np.array([-0.1])
MOTION = Motion(np.zeros(1), *(np.array([[x]]) for x in (0.3, 0.2, 0.5)))
"""Position and velocity of the pendulum [rad], [rad/s], and a reference of one sample."""
TUNING = Tuning(1.0, 0.5)
W = 2 * np.pi
PD = W**2 * 0.2 + W * 0.3
"""What the loop of 1 kg m^2 adds [N m]."""


def _commanded(controller: Feedforward, far: float = 0.0) -> float:
    """Torque of the sample, or of one whose reference is farther away [N m]."""
    series = (MOTION.q + far, MOTION.dq, MOTION.ddq, controller.plan(MOTION))
    return float(controller(Targets(*series).at(0), Q, DQ)[0])


def test_laws_by_hand(pendulum: NominalArm) -> None:
    """The height of the mass is -0.5 sin q: gravity takes -2 * 9.81 * 0.5 cos q; rod and rotor have 1 kg m^2."""
    loop, model = TUNING.gains(np.ones(1)), ArmModel(CorrectedArm(pendulum))
    weight = -9.81 * np.cos(0.3)
    expected = {None: PD, Gravity(pendulum): PD + weight, model: PD + weight + 0.5}
    for fed, torque in expected.items():
        found = _commanded(Feedforward(loop, UNLIMITED, fed))
        assert found == pytest.approx(torque)
    # gravity at the measured position, the inertia times the acceleration that is asked for
    inside = _commanded(ComputedTorque(TUNING, UNLIMITED, model))
    assert inside == pytest.approx(0.5 + PD - 9.81 * np.cos(0.1))


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
    inertia = np.diag(body.mass_matrix(space.posture)) + arm.armature
    controller = (
        ComputedTorque(tuning, limit, model)
        if computed
        else Feedforward(tuning.gains(inertia), limit, model)
    )
    course = SampledReference.of(
        draw_motion("fourier", np.random.default_rng(5), space, 2.0), 2.0, 1e-3
    ).planned(controller)
    with SimulatedArm(arm, encoder_step=arm.encoder_step) as simulated:
        done = track(simulated, controller, course)
    assert not done.diverged and len(done.t) == 2000 and done.t[0] == pytest.approx(0.0)
    assert np.abs(course.motion.q - course.motion.q[0]).max() > 0.3
    assert np.abs(done.q - done.q_ref).max() < 2e-4
