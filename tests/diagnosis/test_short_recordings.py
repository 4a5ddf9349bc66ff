"""Short recordings, on which the model of all effects together runs away beyond the motions that it was fitted to."""

from pathlib import Path

import numpy as np
import pytest
from arms import Link, changed, written

import gapscope
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.recorder import Plan, record_case

LEG = (
    Link("to_hip", "hip", "1 0 0", "0 0 0", 3.4, "0.04 0 -0.03", "0.005 0.005 0.005"),
    Link("to_thigh", "thigh", "0 1 0", "0 0 -0.08", 3.1, "0 0 -0.15", "0.01 0.01 0.01"),
    Link(
        *("to_shank", "shank", "0 1 0", "0 0 -0.35", 0.9, "0 0 -0.12"),
        inertia="0.004 0.004 0.004",
    ),
)


@pytest.mark.filterwarnings("ignore::gapscope.arm.errors.ModelWarning")
def test_friction_with_the_load_of_a_leg_is_found(tmp_path: Path) -> None:
    """The richest model left half of the gap of each half of these recordings, and hid all of it as unknowable."""
    file = written(tmp_path / "leg.urdf", "leg", *changed(LEG, limit="-1.2 0.7 100 5"))
    friction = AppliedEffect("load_friction", (1,), {"coefficient": [0.19]})
    plan = Plan(recordings=2, duration=10.0, rate=100.0, engine="mujoco")
    leg = load_nominal_arm(file)
    case = record_case("leg", leg, (friction,), plan, np.random.default_rng(10))
    [effect] = gapscope.diagnose(case).document["effects"]
    assert effect["effect"] == "load_friction"
    [found] = effect["parameters"]["coefficient"]["value"]
    assert found == pytest.approx(0.19, abs=0.01)
