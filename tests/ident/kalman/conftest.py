"""A three-joint arm and its recordings."""

from types import SimpleNamespace

import numpy as np
import pytest
from arms import iiwa_of_three

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.trajectory import Fourier, urdf_limits
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import record
from gapscope.ident.model.regressor import Regressor

CENTRE = np.array([0.0, 0.6, -1.2])


@pytest.fixture(scope="session")
def arm():
    """Three joints of the iiwa, with rotors and friction."""
    return iiwa_of_three()


@pytest.fixture(scope="session")
def world(arm):
    """Arm, regressor and recorder."""
    controller = position_controller(arm, CENTRE)
    limits = urdf_limits(RigidBody(arm), 6.0)._replace(velocity=np.full(3, 1.3))
    noise = {"encoder_step": 0.0, "encoder_noise": 2e-5, "torque_noise": 0.1}

    def recorded(seed, effects=(), duration=8.0):
        rng = np.random.default_rng(seed)
        how = {"duration": duration, "centre": CENTRE, "frequency": 0.2}
        motion = Fourier.random(rng, limits, **how)
        known = (arm, effects, motion, controller)
        return record(*known, duration=duration, rng=rng, **noise)

    return SimpleNamespace(arm=arm, regressor=Regressor(arm), recorded=recorded)
