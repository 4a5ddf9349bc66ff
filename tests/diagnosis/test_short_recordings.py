"""Short recordings, on which the model of all effects together runs away beyond the motions that it was fitted to."""

from pathlib import Path

import numpy as np
import pytest

import gapscope
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.session import Plan, record_case

LINK = """<link name="{name}"><inertial><origin xyz="{centre}"/><mass value="{mass}"/>
<inertia ixx="{moment}" iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{origin}"/><axis xyz="{axis}"/><limit lower="-1.2" upper="0.7" effort="100" velocity="5"/></joint>"""


def _leg() -> str:
    links = [
        LINK.format(name="hip", mass=3.4, centre="0.04 0 -0.03", moment=0.005),
        LINK.format(name="thigh", mass=3.1, centre="0 0 -0.15", moment=0.01),
        LINK.format(name="shank", mass=0.9, centre="0 0 -0.12", moment=0.004),
    ]
    ends = [("trunk", "hip"), ("hip", "thigh"), ("thigh", "shank")]
    places = [("0 0 0", "1 0 0"), ("0 0 -0.08", "0 1 0"), ("0 0 -0.35", "0 1 0")]
    joints = [
        JOINT.format(
            name=f"to_{child}", parent=parent, child=child, origin=origin, axis=axis
        )
        for (parent, child), (origin, axis) in zip(ends, places, strict=True)
    ]
    return "".join(['<robot name="leg"><link name="trunk"/>', *links, *joints]) + (
        "</robot>"
    )


@pytest.mark.filterwarnings("ignore::gapscope.arm.errors.ModelWarning")
def test_friction_with_the_load_of_a_leg_is_found(tmp_path: Path) -> None:
    """The richest model left half of the gap of each half of these recordings, and hid all of it as unknowable."""
    file = tmp_path / "leg.urdf"
    file.write_text(_leg(), encoding="utf-8")
    friction = AppliedEffect("load_friction", (1,), {"coefficient": [0.19]})
    plan = Plan(recordings=2, duration=10.0, rate=100.0, engine="mujoco")
    leg = load_nominal_arm(file)
    case = record_case("leg", leg, (friction,), plan, np.random.default_rng(10))
    [effect] = gapscope.diagnose(case).document["effects"]
    assert effect["effect"] == "load_friction"
    [found] = effect["parameters"]["coefficient"]["value"]
    assert found == pytest.approx(0.19, abs=0.01)
