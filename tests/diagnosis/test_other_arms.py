"""Arms with sliding joints: a gantry that carries an arm, and a SCARA, recorded with effects, diagnosed in m and N."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from arms import Link, changed, written

import gapscope
from gapscope.arm.case import Case
from gapscope.arm.errors import InputError
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.io.table import numbered
from gapscope.arm.io.write_case import write_columns
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.diagnosis.document.wording import (
    called,
    parameter_texts,
    with_slide_units,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.recorder import Plan, record_case
from gapscope.ident.samples import FrictionLaw, ModelColumns

SLIDE, TURN = "prismatic", "revolute"
GANTRY = (
    ("rail", SLIDE, "0 0 0", "1 0 0", "-1 1 600 1", "0 0 0", 30, 0.5),
    ("arm", TURN, "0 0 .2", "0 1 0", "-2 2 150 2", "0 0 .2", 6, 0.1),
    ("fore", TURN, "0 0 .4", "0 1 0", "-2 2 60 3", ".02 0 .15", 3, 0.04),
)
SCARA = (
    ("j1", TURN, "0 0 .3", "0 0 1", "-2.5 2.5 90 4", ".15 0 0", 6, 0.06),
    ("j2", TURN, ".3 0 0", "0 0 1", "-2.5 2.5 50 5", ".1 .01 0", 4, 0.03),
    ("z", SLIDE, ".25 0 0", "0 0 -1", "0 0.2 200 0.8", "0 0 0", 1.5, 0.003),
)
Row = tuple[str, str, str, str, str, str, float, float]

PLAN = Plan(recordings=2, duration=6.0, rate=125.0, engine="mujoco")


def robot(folder: Path, rows: Iterable[Row]) -> NominalArm:
    """A chain of joints: name, kind, place, axis, limit, centre of mass, mass, moment of inertia."""
    links = [
        Link(
            *(name, f"{name}_link", axis, at, mass, com),
            inertia=f"{moment} {moment} {moment}",
            limit=limit,
            kind=kind,
        )
        for name, kind, at, axis, limit, com, mass, moment in rows
    ]
    return load_nominal_arm(written(folder / "robot.urdf", "slides", *links))


def recorded(
    arm: NominalArm, *effects: AppliedEffect, plan: Plan = PLAN, seed: int = 0
) -> Case:
    """A case of the arm with effects."""
    return record_case(arm.name, arm, effects, plan, np.random.default_rng(seed))


def test_friction_of_a_linear_axis_that_carries_an_arm_is_found_in_newtons(
    tmp_path: Path,
) -> None:
    truth = AppliedEffect("coulomb_friction", (1, 2), {"torque": [40.0, 4.0]})
    result = gapscope.diagnose(recorded(robot(tmp_path, GANTRY), truth))
    [effect] = result.document["effects"]
    assert effect["effect"] == "coulomb_friction" and effect["joints"] == [1, 2]
    torque = effect["parameters"]["torque"]
    assert torque["units"] == ["N", "N m"] and torque["unit"] == "N m or N"
    np.testing.assert_allclose(torque["value"], [40.0, 4.0], rtol=0.05)
    assert result.document["arm"]["sliding"] == [1]
    text = parameter_texts(effect)[0].text
    assert " N," in text and text.endswith(" N m")


def test_mass_that_a_scara_lifts_with_its_slide_is_found(tmp_path: Path) -> None:
    arm = robot(tmp_path, SCARA)
    truth = AppliedEffect("armature", (3,), {"inertia": [4.0]})
    [effect] = gapscope.diagnose(recorded(arm, truth)).document["effects"]
    assert effect["effect"] == "armature" and effect["joints"] == [3]
    assert effect["parameters"]["inertia"]["unit"] == "kg"
    assert effect["parameters"]["inertia"]["value"] == pytest.approx([4.0], rel=0.05)
    healthy = recorded(arm, seed=1)
    assert gapscope.diagnose(healthy).document["verdict"] == "no_gap"
    columns, law = ModelColumns(arm), FrictionLaw()
    units = dict(zip(columns.names(law), columns.units(law), strict=True))
    assert [units[f"{symbol}3"] for symbol in "Ibco"] == ["kg", "N s/m", "N", "N"]
    assert units["c1"] == "N m"


def test_the_check_of_a_slide_speaks_of_newtons(tmp_path: Path) -> None:
    check = gapscope.check(recorded(robot(tmp_path, GANTRY[:1]))).document
    said = str(check["remarks"])
    assert "in N of the joint, gravity included" in said and "N m" not in said
    units = {entry["unit"] for entry in check["expected"] if entry["joints"]}
    assert {"N", "N s/m"} < units and not {"N m", "N m s/rad", "kg m^2"} & units


def test_what_is_said_of_a_slide_is_in_metres_and_newtons() -> None:
    entry = {"joint": 1, "regime": "high speed, |dq| above 0.3 rad/s", "unit": "N m"}
    other = {**entry, "joint": 2}
    content = {"where": [entry, other], "joints": ["a", "b"]}
    slide, turn = with_slide_units(content, (True, False))["where"]
    assert slide["unit"] == "N" and slide["regime"].endswith("0.3 m/s")
    assert turn == other


def test_positions_in_millimetres_are_refused_with_their_unit(tmp_path: Path) -> None:
    arm = robot(tmp_path, GANTRY)
    t = np.arange(0, 2, 0.01)
    q = np.column_stack([800 * np.sin(t), np.sin(t), np.sin(t)])
    file = tmp_path / "motion.csv"
    write_columns(numbered({"t": t, "q": q, "tau": q}), file)
    with pytest.raises(InputError, match="looks like millimetres(.|\n)*unit: mm"):
        load_recording(file, arm)


# An arm whose joints turn about parallel axes, as of a larger arm whose other joints are locked, along one plane.


PLANAR = tuple(f"lbr_iiwa_joint_{k}" for k in (2, 4, 6))
LONGER = Plan(recordings=2, duration=10.0, rate=100.0, engine="mujoco")


def test_a_load_is_found_though_its_centre_along_the_axes_does_nothing() -> None:
    every = load_nominal_arm("kuka_iiwa").joints
    locked = {joint: 0.0 for joint in every if joint not in PLANAR}
    planar = load_nominal_arm("kuka_iiwa", joints=PLANAR, locked=locked)
    load = AppliedEffect("payload", (), {"mass": 2.0, "com": [0.0, 0.0, 0.08]})
    document = gapscope.diagnose(recorded(planar, load, plan=LONGER)).document
    [effect] = document["effects"]
    assert effect["effect"] == "payload"
    mass = effect["parameters"]["mass"]
    assert abs(mass["value"] - 2.0) < max(0.1, 3 * mass["std"])
    assert document["unexplained"]["above_floor"] is False


# Short recordings, on which the model of all effects together runs away beyond the motions that it was fitted to.


LEG = (
    Link("to_hip", "hip", "1 0 0", "0 0 0", 3.4, "0.04 0 -0.03", "0.005 0.005 0.005"),
    Link("to_thigh", "thigh", "0 1 0", "0 0 -0.08", 3.1, "0 0 -0.15", "0.01 0.01 0.01"),
    Link("to_shank", "shank", "0 1 0", "0 0 -.35", 0.9, "0 0 -.12", ".004 .004 .004"),
)


@pytest.mark.filterwarnings("ignore::gapscope.arm.errors.ModelWarning")
def test_friction_with_the_load_of_a_leg_is_found(tmp_path: Path) -> None:
    """The richest model left half of the gap of each half of these recordings, and hid all of it as unknowable."""
    file = written(tmp_path / "leg.urdf", "leg", *changed(LEG, limit="-1.2 0.7 100 5"))
    friction = AppliedEffect("load_friction", (1,), {"coefficient": [0.19]})
    case = recorded(load_nominal_arm(file), friction, plan=LONGER, seed=10)
    [effect] = gapscope.diagnose(case).document["effects"]
    assert effect["effect"] == "load_friction"
    [found] = effect["parameters"]["coefficient"]["value"]
    assert found == pytest.approx(0.19, abs=0.01)


def test_what_no_motion_of_a_slide_tells_apart_is_one_cause(tmp_path: Path) -> None:
    truth = AppliedEffect("torque_offset", (1,), {"torque": [30.0]})
    slide = recorded(robot(tmp_path, GANTRY[:1]), truth)
    document = gapscope.diagnose(slide).document
    [effect] = document["effects"]
    names = {o["effect"] for o in effect["alternatives"] if o["equivalent"]}
    assert {effect["effect"], *names} >= {"torque_offset", "base_tilt"}
    assert document["verdict"] == "effects_found" and effect["probability"] > 0.9
    assert all(name.replace("_", " ") in called(effect) for name in names)
