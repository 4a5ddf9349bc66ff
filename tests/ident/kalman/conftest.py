"""A three-joint arm that picks something up, or not."""

from types import SimpleNamespace

import numpy as np
import pytest
from arms import iiwa_of_three
from problems import Assembly

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.trajectory import Fourier, urdf_limits
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import record
from gapscope.ident.model.base_parameters import structural_base
from gapscope.ident.model.regressor import Regressor

CENTRE = np.array([0.0, 0.6, -1.2])


@pytest.fixture(scope="session")
def arm():
    """Three joints of the iiwa, with rotors and friction."""
    return iiwa_of_three()


@pytest.fixture(scope="session")
def world(arm):
    """Regressor, base parameters, assembly and a recorder of the arm."""
    regressor = Regressor(arm)
    base = structural_base(regressor, np.random.default_rng(0))
    controller = position_controller(arm, CENTRE)

    def recorded(seed, effects=(), pickup=None, duration=8.0, **other):
        """A recording; ``pickup``: time [s] and mass [kg]."""
        rng = np.random.default_rng(seed)
        limits = urdf_limits(RigidBody(arm), 6.0)._replace(velocity=np.full(3, 1.3))
        motion = Fourier.random(
            rng, limits, duration=duration, centre=CENTRE, frequency=0.2
        )
        later = None
        if pickup is not None:
            later = (
                pickup[0],
                (
                    *effects,
                    AppliedEffect(
                        "payload", (), {"mass": pickup[1], "com": [0.02, 0.0, 0.05]}
                    ),
                ),
            )
        return record(
            arm,
            effects,
            motion,
            controller,
            duration=duration,
            rng=rng,
            encoder_step=0.0,
            encoder_noise=2e-5,
            torque_noise=0.1,
            later=later,
            **other,
        )

    assembly = Assembly(regressor, base, cutoff=20.0, every=10)
    return SimpleNamespace(
        arm=arm, regressor=regressor, base=base, assembly=assembly, recorded=recorded
    )
