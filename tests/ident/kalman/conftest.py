"""A three-joint arm and its recordings."""

from types import SimpleNamespace

import numpy as np
import pytest
from arms import iiwa_of_three
from cases import swinging

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
    limits = {"speed": 1.3, "acceleration": 6.0, "frequency": 0.2}
    noise = {"encoder_step": 0.0, "encoder_noise": 2e-5, "torque_noise": 0.1}

    def recorded(seed, effects=(), duration=4.0):
        rng = np.random.default_rng(seed)
        motion = swinging(arm, rng, CENTRE, duration=duration, **limits)
        known = (arm, effects, motion, controller)
        return record(*known, duration=duration, rng=rng, **noise)

    return SimpleNamespace(arm=arm, regressor=Regressor(arm), recorded=recorded)
