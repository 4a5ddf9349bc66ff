"""An arm identified on Fourier motions, judged on one at another frequency, on picking and on welding a seam."""

from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.named_motions import draw_motion, workspace
from gapscope.arm.motions.trajectory import Fourier
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.mystery_arm import iiwa
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import record
from gapscope.ident.identification import IdentificationSettings, identify, validate
from gapscope.ident.samples import Band

EFFECTS = (
    AppliedEffect("payload", (), {"mass": 2.0, "com": [0.02, 0.01, 0.08]}),
    AppliedEffect("viscous_friction", (1, 2, 4), {"coefficient": [2.0, -1.5, 1.0]}),
)
DURATION = 6.0
OTHERS = ("fourier 0.37", "pick", "place", "weld_seam")


@pytest.fixture(scope="module")
def identified():
    """An iiwa with a payload and other friction than its data sheet says, identified on three Fourier motions."""
    pytest.importorskip("pybullet_data")
    arm, rng = iiwa(), np.random.default_rng(0)
    space = workspace(RigidBody(arm))
    motions = {
        f"fourier {frequency:g}": Fourier.random(
            rng,
            space.limits,
            duration=DURATION,
            centre=space.posture,
            frequency=frequency,
            ramp=1.0,
        )
        for frequency in (0.17, 0.2, 0.25, 0.37)
    } | {name: draw_motion(name, rng, space, DURATION) for name in OTHERS[1:]}
    controller = position_controller(arm, space.posture)
    recordings = tuple(
        record(
            arm,
            EFFECTS,
            motion,
            controller,
            duration=DURATION,
            rng=rng,
            torque_noise=0.05,
            name=name,
        )
        for name, motion in motions.items()
    )
    case = Case("iiwa", Path(), arm, recordings, controller=controller)
    return identify(case, IdentificationSettings(cutoff=20.0, judge=OTHERS))


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHERS)
def test_what_was_identified_holds_on_another_motion(identified, name):
    band, law, columns = Band(20.0), identified.choice.law, identified.columns
    (recording,) = (one for one in identified.case.recordings if one.name == name)
    nominal = columns.nominal(law)
    found = validate(
        "judge",
        band.segments([recording]),
        band,
        lambda segment: identified.predict(segment.motion),
        lambda segment: columns.matrix(segment.motion, law) @ nominal,
    )
    assert found.nominal.overall > 0.2
    assert found.moving.overall < 0.01
    assert found.every.overall < 0.08
    assert (found.moving.rmse < 0.3).all()
    assert (found.moving.largest <= found.every.largest).all()
    assert found.moving.largest.max() < 1.5
