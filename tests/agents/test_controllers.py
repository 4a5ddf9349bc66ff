"""Controllers: values worked out by hand on a pendulum."""

import numpy as np
import pytest

from gapscope.agents.models import ArmModel, Gravity
from gapscope.agents.tracking import ComputedTorque, Feedforward, Tuning
from gapscope.arm.control import Targets
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.effects.corrected import CorrectedArm

UNLIMITED = np.array([np.inf])
Q, DQ = np.array([0.1]), np.array([-0.1])
MOTION = Motion(np.zeros(1), *(np.array([[x]]) for x in (0.3, 0.2, 0.5)))
"""Position and velocity of the pendulum [rad], [rad/s], and a reference of one sample."""
TUNING = Tuning(1.0, 0.5)
W = 2 * np.pi
PD = W**2 * 0.2 + W * 0.3
"""What the loop of 1 kg m^2 adds [N m]."""


def _commanded(controller: Feedforward) -> float:
    """Torque of the sample [N m]."""
    series = (MOTION.q, MOTION.dq, MOTION.ddq, controller.plan(MOTION))
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
