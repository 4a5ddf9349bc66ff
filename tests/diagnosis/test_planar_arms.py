"""An arm whose joints turn about parallel axes, as of a larger arm whose other joints are locked, along one plane."""

import numpy as np
import pytest

import gapscope
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.recorder import Plan, record_case

PLANAR = tuple(f"lbr_iiwa_joint_{k}" for k in (2, 4, 6))
PLAN = Plan(recordings=2, duration=10.0, rate=100.0, engine="mujoco")


@pytest.fixture
def planar() -> NominalArm:
    others = [j for j in load_nominal_arm("kuka_iiwa").joints if j not in PLANAR]
    return load_nominal_arm(
        "kuka_iiwa", joints=PLANAR, locked=dict.fromkeys(others, 0.0)
    )


def test_a_load_is_found_though_its_centre_along_the_axes_does_nothing(
    planar: NominalArm,
) -> None:
    load = AppliedEffect("payload", (), {"mass": 2.0, "com": [0.0, 0.0, 0.08]})
    case = record_case("planar", planar, (load,), PLAN, np.random.default_rng(0))
    document = gapscope.diagnose(case).document
    [effect] = document["effects"]
    assert effect["effect"] == "payload"
    mass = effect["parameters"]["mass"]
    assert abs(mass["value"] - 2.0) < max(0.1, 3 * mass["std"])
    assert document["unexplained"]["above_floor"] is False
