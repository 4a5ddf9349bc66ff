"""Snippets for other simulators: they run with stand-ins of the packages, and hold the arm's numbers."""

from __future__ import annotations

import builtins
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from gapscope.arm.control import PD
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.effect_ranges import (
    EffectRange,
    EffectRanges,
    effect_range,
    within_nominal,
)
from gapscope.envs.export.formats import export
from gapscope.envs.export.plain_arm import TARGETS

EFFECTS = (
    AppliedEffect("coulomb_friction", (2,), {"torque": [4.0]}),
    AppliedEffect("viscous_friction", (2,), {"coefficient": [3.0]}),
    AppliedEffect("stribeck_friction", (2,), {"torque": [1.5], "velocity": [0.1]}),
    AppliedEffect("armature", (1,), {"inertia": [0.4]}),
    AppliedEffect("payload", (), {"mass": 1.0, "com": [0.02, 0.0, 0.05]}),
    AppliedEffect("actuator_delay", (4,), {"delay": [0.0101]}),
    AppliedEffect("torque_scale", (3,), {"scale": [0.2]}),
    AppliedEffect("torque_offset", (5,), {"torque": [0.7]}),
    AppliedEffect("encoder_offset", (6,), {"offset": [0.02]}),
    AppliedEffect("parallel_spring", (2,), {"stiffness": [12.0], "rest": [0.3]}),
    AppliedEffect("torque_saturation", (4,), {"limit": [20.0]}),
)
KP, KD = 100.0 * np.arange(1, 8), 10.0 * np.arange(1, 8)
WIDTH = 0.1 * 1.96
"""Half an interval over its value, if the standard deviation is a tenth of the value."""
PYTHON = ("isaac_lab", "mjlab", "newton", "genesis", "drake")
ISAAC_LAB = {
    *("joint_names_expr", "stiffness", "damping", "armature", "friction"),
    *("dynamic_friction", "viscous_friction", "min_delay", "max_delay"),
    *("actuator_effort_limit", "actuator_velocity_limit"),
}
"""Fields of DelayedPDActuatorCfg of Isaac Lab 3.0, see docs/export_targets.md."""
MJLAB = {
    *("target_names_expr", "stiffness", "damping", "effort_limit", "armature"),
    *("frictionloss", "viscous_damping", "delay_min_lag", "delay_max_lag"),
    *("delay_update_period", "delay_per_env_phase"),
}
"""Fields of IdealPdActuatorCfg of mjlab 1.6, see docs/export_targets.md."""


ARM = CorrectedArm(load_nominal_arm("kuka_iiwa"), EFFECTS)
RANGES = within_nominal(
    [
        effect_range(x, {k: 0.1 * np.abs(v) for k, v in x.parameters.items()})
        for x in EFFECTS
    ],
    ARM.arm,
)
CONTROLLER = PD(rate=500.0, kp=KP, kd=KD)
ONE, TWO, THREE, FOUR = (f"lbr_iiwa_joint_{k}" for k in (1, 2, 3, 4))


class StandIn:
    """What a snippet imports: its attributes are stand-ins, and a call keeps what it is given."""

    def __init__(self, kind: str) -> None:
        self.kind = kind

    def __getattr__(self, name: str) -> StandIn:
        return StandIn(name)

    def __call__(self, *args: Any, **fields: Any) -> SimpleNamespace:
        return SimpleNamespace(kind=self.kind, args=args, **fields)


def imported(name: str, *more: Any) -> Any:
    return __import__(name, *more) if name in ("math", "numpy") else StandIn(name)


def run(path: Path) -> dict[str, Any]:
    """Names that a snippet defines, with stand-ins for what it imports."""
    scope = {"__builtins__": {**vars(builtins), "__import__": imported}}
    exec(compile(path.read_text(encoding="utf-8"), str(path), "exec"), scope)
    return scope


@pytest.fixture
def snippet(tmp_path: Path) -> Any:
    """Runs the snippet of a simulator."""

    def written(form: str, randomise: bool = False) -> dict[str, Any]:
        path, chosen = tmp_path / f"{form}.py", RANGES if randomise else None
        export(ARM, form, path, controller=CONTROLLER, ranges=chosen)
        return run(path)

    return written


def test_isaac_lab_holds_friction_rotors_limits_and_gains(snippet: Any) -> None:
    groups = snippet("isaac_lab")["ACTUATORS"].values()
    first, late = groups
    assert (first.dynamic_friction[TWO], first.friction[TWO]) == (4.0, 5.5)
    assert first.viscous_friction[TWO] == 3.5  # of which 0.5 in the URDF
    others = {name: 0.0 for name in first.joint_names_expr}
    assert first.armature == pytest.approx(others | {ONE: 0.4})
    # what reaches joint 3 is 1.2 times what is commanded
    assert first.stiffness[THREE] == pytest.approx(360)
    assert late.actuator_effort_limit == {FOUR: 20.0}
    for group in groups:
        assert set(vars(group)) - {"kind", "args"} <= ISAAC_LAB


def test_isaac_lab_draws_within_the_intervals(snippet: Any) -> None:
    scope = snippet("isaac_lab", randomise=True)
    events, (_, late) = scope["EVENTS"], scope["ACTUATORS"].values()
    armature = events["armature_lbr_iiwa_joint_1"]
    assert armature.func.kind == "randomize_joint_parameters"
    drawn = armature.params["armature_distribution_params"]
    assert drawn == pytest.approx((0.4 * (1 - WIDTH), 0.4 * (1 + WIDTH)))
    # a factor for all of the joint's friction: the widest of its parts
    factor = events["friction_lbr_iiwa_joint_2"].params
    assert factor["operation"] == "scale"
    drawn = factor["friction_distribution_params"]
    assert drawn == pytest.approx((1 - WIDTH, 1 + WIDTH))
    mass = events["mass_lbr_iiwa_link_7"].params
    assert mass["mass_distribution_params"] == pytest.approx((-WIDTH, WIDTH))
    # 0.0101 s +- 0.00198 s in steps of 5 ms, outwards
    assert (late.min_delay, late.max_delay) == (1, 3)


def test_isaac_lab_says_that_a_range_from_zero_has_no_factor(tmp_path: Path) -> None:
    ends = ({"torque": [0.0]}, {"torque": [1.5]})
    both = EffectRange(*(AppliedEffect("coulomb_friction", (6,), x) for x in ends))
    export(ARM, "isaac_lab", tmp_path / "s.py", ranges=EffectRanges((both,)))
    text = (tmp_path / "s.py").read_text(encoding="utf-8")
    assert "# friction of lbr_iiwa_joint_6 is 0 here and (0.0, 1.5)" in text
    assert "friction_lbr_iiwa_joint_6" not in text


def test_mjlab_holds_the_joints_biases_encoders_and_draws_by_joint(
    snippet: Any,
) -> None:
    actuators = {a.target_names_expr[0]: a for a in snippet("mjlab")["ACTUATORS"]}
    two, four = actuators[TWO], actuators[FOUR]
    assert (two.frictionloss, two.viscous_damping) == (4.0, 3.5)
    assert (four.delay_min_lag, four.delay_max_lag) == (5, 5)
    assert four.effort_limit == 20.0
    for actuator in actuators.values():
        assert set(vars(actuator)) - {"kind", "args"} <= MJLAB
    events = snippet("mjlab", randomise=True)["EVENTS"]
    ranges = events["joint_friction"].params["ranges"]
    assert ranges == {TWO: pytest.approx((4 * (1 - WIDTH), 4 * (1 + WIDTH)))}
    bias = events["encoder_lbr_iiwa_joint_6"].params["bias_range"]
    # beside the offset found, which the MJCF has
    assert bias == pytest.approx((-0.02 * WIDTH, 0.02 * WIDTH))


class Calls:
    """An object of another program, of which each method keeps what it was given last."""

    def __init__(self, **known: Any) -> None:
        self.last: dict[str, Any] = {}
        vars(self).update(known)

    def __getattr__(self, name: str) -> Any:
        return lambda *values: self.last.__setitem__(name, values)


def newton_builder(*labels: str) -> SimpleNamespace:
    """As much of newton.ModelBuilder as the snippet uses."""
    n = len(labels)
    places = {"joint_qd_start": list(range(n)), "joint_q_start": list(range(n))}
    built = SimpleNamespace(joint_label=list(labels), actuators=[], **places)
    for name in ("damping", "friction", "armature", "stiffness", "rest_q"):
        setattr(built, f"joint_{name}", [0.0] * n)
    built.joint_target_ke, built.joint_target_kd = [9.0] * n, [9.0] * n
    built.add_actuator = lambda drive, **given: built.actuators.append(given)
    return built


def test_newton_sets_each_joint_of_the_builder_and_draws_one_factor(
    snippet: Any,
) -> None:
    builder = newton_builder(*(f"arm/{x}" for x in (FOUR, THREE, TWO)), "other")
    snippet("newton")["add_actuators"](builder)
    assert builder.joint_friction == [0.0, 0.0, 4.0, 0.0]
    assert builder.joint_stiffness == [0.0, 0.0, 12.0, 0.0]
    assert builder.joint_target_ke == [0.0, 0.0, 0.0, 9.0]
    four, three, _ = builder.actuators
    assert (four["delay_steps"], three["delay_steps"]) == (5, None)
    assert three["kp"] == pytest.approx(360)
    assert four["clamping"][0][1] == {"max_effort": 20.0}

    builder, rng = newton_builder(*[THREE] * 20), np.random.default_rng(0)
    snippet("newton", randomise=True)["add_actuators"](builder, rng)
    kp, kd = (np.array([a[key] for a in builder.actuators]) for key in ("kp", "kd"))
    clamps = [a["clamping"][0][1]["max_effort"] for a in builder.actuators]
    assert kp == pytest.approx(10 * kd) and kp == pytest.approx(np.array(clamps))
    assert (np.abs(kp / 300 - 1.2) <= 0.2 * WIDTH).all() and np.ptp(kp) > 0


def test_genesis_has_values_of_its_own_in_each_environment(snippet: Any) -> None:
    joint = lambda name: SimpleNamespace(dofs_idx_local=[int(name[-1]) - 1])  # noqa: E731
    robot = Calls(get_joint=joint)
    set_joints = snippet("genesis", randomise=True)["set_joints"]
    set_joints(robot)
    assert robot.last["set_dofs_frictionloss"][0].tolist() == [0, 4, 0, 0, 0, 0, 0]
    assert robot.last["set_dofs_frictionloss"][1] == list(range(7))
    set_joints(robot, np.random.default_rng(0), 5)
    drawn = robot.last["set_dofs_frictionloss"][0]
    assert drawn.shape == (5, 7) and np.ptp(drawn[:, 1]) > 0
    low, high, _ = robot.last["set_dofs_force_range"]
    kp = robot.last["set_dofs_kp"][0]
    assert (low == -high).all() and high[:, 2] == pytest.approx(kp[:, 2])


def test_drake_divides_the_rotor_by_the_square_of_the_gear(snippet: Any) -> None:
    scope, actuator = snippet("drake"), Calls()
    plant = SimpleNamespace(
        GetJointActuatorIndices=lambda: [],
        GetJointByName=lambda name: SimpleNamespace(set_default_damping=print),
        AddJointActuator=lambda name, joint: actuator,
    )
    scope |= {"RevoluteJoint": str, "GEAR_RATIO": 100.0}
    scope["JOINTS"] = {ONE: scope["JOINTS"][ONE]}
    scope["set_joints"](plant)
    (rotor,), (gear,) = (
        actuator.last[f"set_default_{x}"] for x in ("rotor_inertia", "gear_ratio")
    )
    assert (rotor, gear) == (pytest.approx(0.4 / 1e4), 100.0)


def test_playground_names_fields_joints_and_bodies(snippet: Any) -> None:
    scope = snippet("playground", randomise=True)
    assert set(scope["RANGES"]) == {"dof_frictionloss", "dof_damping", "dof_armature"}
    damping = pytest.approx((3.5 - 3 * WIDTH, 3.5 + 3 * WIDTH))
    assert scope["RANGES"]["dof_damping"] == {TWO: damping}
    assert scope["ADDED_MASS"]["lbr_iiwa_link_7"] == pytest.approx((-WIDTH, WIDTH))
    # the centre of link and payload together moves by the payload's share of the mass
    (low, high), *_ = scope["ADDED_COM"]["lbr_iiwa_link_7"]
    own = RigidBody(ARM.arm).inertial_parameters()[-10]
    assert high == pytest.approx(0.02 * WIDTH / (1.0 + own), rel=1e-5) and low == -high


def test_gazebo_holds_dynamics(tmp_path: Path) -> None:
    export(ARM, "gazebo", tmp_path / "joints.xml")
    joints = ET.parse(tmp_path / "joints.xml").getroot()
    two = joints.find(f"joint[@name='{TWO}']/axis/dynamics")
    expected = {"damping": 3.5, "friction": 4.0, "spring_reference": 0.3}
    expected["spring_stiffness"] = 12.0
    assert {each.tag: float(each.text or "") for each in two} == expected


def test_ros2_control_feeds_viscous_friction_forward(tmp_path: Path) -> None:
    export(ARM, "ros2_control", tmp_path / "c.yaml", controller=CONTROLLER)
    text = (tmp_path / "c.yaml").read_text(encoding="utf-8")
    gains = yaml.safe_load(text)["joint_trajectory_controller"]["ros__parameters"]
    # names and types of joint_trajectory_controller_parameters.yaml in ros2_controllers
    assert gains.keys() == {"joints", "command_interfaces", "state_interfaces", "gains"}
    assert gains["gains"].keys() == set(gains["joints"])
    for own in gains["gains"].values():
        assert own.keys() <= {"p", "d", "ff_velocity_scale", "u_clamp_max", "u_clamp_min"}  # fmt: skip
        # a whole number is refused: expected double, got integer
        assert all(type(value) is float for value in own.values())
    four, three = gains["gains"][FOUR], gains["gains"][THREE]
    assert (four["p"], four["u_clamp_max"], four["u_clamp_min"]) == (400, 20, -20)
    # 1.2 times what is commanded arrives, so that less has to be
    assert three["ff_velocity_scale"] == pytest.approx(0.5 / 1.2, rel=1e-5)
    assert "lbr_iiwa_joint_6: -0.02\n" in text


@pytest.mark.parametrize("form", PYTHON)
def test_what_is_not_held_is_in_the_head_and_returned(
    tmp_path: Path, form: str
) -> None:
    left_out, _ = export(ARM, form, tmp_path / "s.py")
    head = (tmp_path / "s.py").read_text(encoding="utf-8").split("import")[0]
    named = {line.split(":")[0].split(",")[0] for line in left_out}
    assert {"payload", "torque_offset"} <= named
    springless = form in ("isaac_lab", "mjlab", "genesis")
    assert ("parallel_spring" in named) == springless
    assert all(line in head for line in left_out)
    # a healthy arm has a snippet, too
    assert export(CorrectedArm(ARM.arm), form, tmp_path / "s.py")[0] == ()
    run(tmp_path / "s.py")


@pytest.mark.parametrize(
    ("form", "ranges", "message"),
    [
        *((form, RANGES, "ranges") for form in ("gazebo", "ros2_control", "urdf")),
        *((n, None, "ranges alone") for n, t in TARGETS.items() if t.needs_ranges),
    ],
)
def test_ranges_of_a_format_without_them_and_none_of_one_with_them_alone_are_refused(
    tmp_path: Path, form: str, ranges: EffectRanges | None, message: str
) -> None:
    with pytest.raises(InputError, match=message) as error:
        export(ARM, form, tmp_path / "file", ranges=ranges)
    assert ranges is None or "isaac_lab" in error.value.remedy
    assert not (tmp_path / "file").exists()
