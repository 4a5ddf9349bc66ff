"""Robots as their makers publish them: trees with grippers and mobile bases, followers, xacro, impossible antennas."""

import sys
import types
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.case import Case, load_case
from gapscope.arm.dynamics.description import read_description
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.io.table import numbered
from gapscope.arm.io.write_case import write_case, write_columns
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import (
    KNOWN_ROBOTS,
    load_nominal_arm,
    placeholder,
    pybullet_data,
    shifted_arm,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.interface.models import export

BODY = (
    '<inertial><origin xyz="0 0 0.1"/><mass value="{0}"/>'
    '<inertia ixx="{1}" iyy="{1}" izz="{1}" ixy="0" ixz="0" iyz="0"/></inertial>'
)


def link(name: str, mass: float = 0, moment: float = 0.01) -> str:
    inertial = BODY.format(mass, moment) if mass else ""
    return f'<link name="{name}">{inertial}</link>'


LIMIT = '<limit lower="-2" upper="2" effort="50" velocity="2"/>'


def joint(
    name: str, parent: str, child: str, kind: str = "revolute", more: str = ""
) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>{LIMIT}{more}</joint>'
    )


FOLLOWS = '<mimic joint="finger_1" multiplier="-1"/>'
ARM = (
    joint("shoulder", "torso", "upper") + link("upper", 3)
    + joint("elbow", "upper", "lower") + link("lower", 2)
    + joint("flange", "lower", "hand", "fixed") + link("hand", 0.5)
)  # fmt: skip
FINGERS = (
    joint("finger_1", "hand", "left", "prismatic") + link("left", 0.2)
    + joint("finger_2", "hand", "right", "prismatic", FOLLOWS) + link("right", 0.2)
)  # fmt: skip
ANTENNA = link("antenna", 1e-6, moment=-1e-8)
LEAN = joint("lean", "base", "torso") + link("torso", 8)
BASE = (
    link("world") + joint("drive", "world", "base", "floating") + link("base", 20)
    + joint("wheel", "base", "tyre", "continuous") + link("tyre", 1)
    + joint("whip", "base", "antenna", "fixed") + ANTENNA + LEAN
)  # fmt: skip


def robot(folder: Path, *parts: str) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="tree">{"".join(parts)}</robot>')
    return path


TORSO = link("torso")
CHAIN = {"chain": ["torso", "hand"]}


def torque(arm: NominalArm) -> np.ndarray:
    """Torque of one motion [N m], shape (20, n)."""
    q, dq, ddq = np.random.default_rng(0).uniform(-1, 1, (3, 20, arm.n_joints))
    return RigidBody(arm).inverse_dynamics(q, dq, ddq)


def notes_of(urdf: Path, **options: object) -> tuple[NominalArm, str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        arm = load_nominal_arm(urdf, **options)  # type: ignore[arg-type]
    return arm, "\n".join(str(warning.message) for warning in caught)


def test_a_chain_is_the_arm_alone_with_what_hangs_on_its_tip(tmp_path: Path) -> None:
    arm, notes = notes_of(robot(tmp_path, BASE, ARM, FINGERS), **CHAIN)
    assert arm.joints == ("shoulder", "elbow") and "wheel" not in notes
    assert all(x in notes for x in ("antenna", "drive", "lean", "finger_1"))
    fixed = FINGERS.replace('"prismatic"', '"fixed"')
    plain = load_nominal_arm(robot(tmp_path / "plain", TORSO, ARM, fixed))
    np.testing.assert_allclose(torque(arm), torque(plain), atol=1e-12)


@pytest.mark.parametrize("encoding", ["ISO-8859-1", "UTF-16"])
def test_inertials_move_in_any_encoding(tmp_path: Path, encoding: str) -> None:
    path = robot(tmp_path, link("torso", 1), ARM)
    moved = torque(shifted_arm(load_nominal_arm(path), 1))
    text = f'<?xml version="1.0" encoding="{encoding}"?><!-- Grüße -->'
    path.write_text(text + path.read_text(), encoding)
    np.testing.assert_array_equal(torque(shifted_arm(load_nominal_arm(path), 1)), moved)


WHIP = joint("whip", "upper", "antenna", "fixed") + ANTENNA
FAR = ARM.replace('upper="2"', 'upper="far"', 1)
BRAKED = ARM.replace("<axis", '<dynamics damping="-2"/><axis', 1)
REFUSED = [
    ((BASE, ARM), {"chain": ["hand", "torso"]}, "does not hang on 'hand'"),
    ((BASE, ARM), {"chain": ["torso", "hands"]}, "did you mean 'hand'"),
    ((TORSO, ARM, WHIP), {}, "link antenna.*none below zero"),
    ((BASE, ARM, FINGERS), {**CHAIN, "locked": {"elbow": 1}}, "one of the arm's joints"),
    ((BASE, ARM, FINGERS), {**CHAIN, "locked": {"finger": 1}}, "no movable joint 'finger'"),
    ((TORSO, BRAKED), {}, "joint shoulder: its damping is -2, expected zero or above"),
    ((TORSO, FAR), {}, "joint shoulder, <limit upper>: expected a number"),
    ((BASE, ARM, link("adrift")), {}, "several bases: world, adrift(?s:.*)chain:"),
]  # fmt: skip


@pytest.mark.parametrize(("parts", "options", "message"), REFUSED)
def test_what_is_no_arm_is_refused_with_the_reason(
    parts: tuple, options: dict, message: str, tmp_path: Path, silent: None
) -> None:
    with pytest.raises(InputError, match=message):
        load_nominal_arm(robot(tmp_path, *parts), **options)


@pytest.fixture
def silent(capfd: pytest.CaptureFixture[str]) -> Iterator[None]:
    """Libraries that read the file say nothing of their own."""
    yield
    assert capfd.readouterr() == ("", "")


def test_locked_joints_stand_where_the_case_says(tmp_path: Path) -> None:
    tree = robot(tmp_path, BASE, ARM, FINGERS)
    leaning = load_nominal_arm(tree, **CHAIN, locked={"lean": 0.5})
    # the torso leans about y: gravity turns back in its frame
    turned = [-9.81 * -np.sin(0.5), 0, -9.81 * np.cos(0.5)]
    upright = load_nominal_arm(tree, **CHAIN, gravity=turned)
    np.testing.assert_allclose(torque(leaning), torque(upright), atol=1e-9)
    open_hand = load_nominal_arm(tree, **CHAIN, locked={"finger_1": 0.4})
    assert open_hand.locked == {"finger_1": 0.4, "finger_2": -0.4}


def test_a_follower_weighs_on_its_master(tmp_path: Path) -> None:
    tree = robot(tmp_path, TORSO, ARM, FINGERS)
    with pytest.warns(ModelWarning, match="finger_2 follows finger_1"):
        arm = load_nominal_arm(tree)
    assert arm.joints == ("shoulder", "elbow", "finger_1")
    assert arm.sliding == (False, False, True)
    # both fingers slide apart: the second one adds its mass of 0.2 kg
    np.testing.assert_allclose(arm.armature, [0, 0, 0.2])


def test_a_locked_joint_stands_at_the_mean_of_a_column(tmp_path: Path) -> None:
    tree, t = robot(tmp_path, TORSO, ARM, FINGERS), np.arange(0, 2, 0.01)
    both = np.sin(t)[:, None] * np.ones(2)
    columns = numbered({"t": t, "q": both, "tau": both, "gripper": 0.3 + 0 * t})
    write_columns(columns, tmp_path / "a.csv")
    text = "name: x\nrobot: robot.urdf\nchain: [torso, hand]\nrecordings: [a.csv]\n"
    (tmp_path / "case.yaml").write_text(text + "locked: {finger_1: gripper}\n")
    case = load_case(tmp_path)
    found = pytest.approx({"finger_1": 0.3, "finger_2": -0.3})
    assert case.arm.locked == found
    locked = {"finger_1": 0.3}
    memory = Case.from_arrays(tree, t=t, q=both, tau=both, **CHAIN, locked=locked)
    for other in (memory, load_case(write_case(case, tmp_path / "case"))):
        assert other.arm.locked == found
        np.testing.assert_allclose(torque(other.arm), torque(case.arm), atol=1e-9)
    # a cell without a value has no say
    lines = (tmp_path / "a.csv").read_text().split("\n")
    lines[9] = lines[9].rpartition(",")[0] + ","
    (tmp_path / "a.csv").write_text("\n".join(lines))
    assert load_case(tmp_path).arm.locked == found
    (tmp_path / "case.yaml").write_text(text + "locked: {finger_1: grip}\n")
    with pytest.raises(InputError, match="field locked.finger_1.*'grip'"):
        load_case(tmp_path)


def test_an_exported_urdf_keeps_locked_joints_in_place(tmp_path: Path) -> None:
    tree = robot(tmp_path, link("base"), LEAN, ARM, FINGERS)
    arm = load_nominal_arm(tree, **CHAIN, locked={"lean": 0.5, "finger_1": 0.4})
    export(CorrectedArm(arm, ()), tmp_path / "out.urdf")
    exported = load_nominal_arm(tmp_path / "out.urdf")
    assert exported.joints == arm.joints
    np.testing.assert_allclose(torque(exported), torque(arm), atol=1e-9)


XACRO = [
    ("arm.urdf.xacro", "<robot/>"),
    ("arm.urdf", '<robot><link name="${prefix}base"/></robot>'),
    ("arm.urdf", '<robot><mesh filename="$(find ur)/a.stl"/></robot>'),
    ("arm.urdf", "<robot><xacro:include filename='a'/></robot>"),
]


@pytest.mark.parametrize(("name", "text"), XACRO)
def test_xacro_is_refused_with_the_command_that_expands_it(
    name: str, text: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=r"xacro .* > robot.urdf.*xacrodoc"):
        load_nominal_arm(tmp_path / name)


NAME = "robot_descriptions"


def test_robot_descriptions_are_known_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package, module = (types.ModuleType(x) for x in (NAME, f"{NAME}.two_description"))
    package.__path__, package.__spec__ = [], types.SimpleNamespace(name=NAME)
    module.URDF_PATH = str(robot(tmp_path, TORSO, ARM))
    for each in (package, module):
        monkeypatch.setitem(sys.modules, each.__name__, each)
    assert load_nominal_arm("two_description").joints == ("shoulder", "elbow")
    with pytest.raises(InputError, match="has no three_description"):
        load_nominal_arm("three_description")
    monkeypatch.setattr("gapscope.arm.robots.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"gapscope\[robots\]"):
        load_nominal_arm("ur5e_description")


MJCF = """<mujoco model="hand">
  <default><position kp="100" kv="5"/></default>
  <worldbody><body name="base"><freejoint/><inertial pos="0 0 0" mass="5" diaginertia="1 1 1"/>
    <body name="upper"><joint name="shoulder" axis="0 1 0"/><inertial pos="0 0 .2" mass="2" diaginertia=".1 .1 .1"/>
      <body name="left"><joint name="f1" type="slide" axis="0 1 0"/>
        <inertial pos="0 0 0" mass=".2" diaginertia="1e-4 1e-4 1e-4"/></body>
      <body name="right"><joint name="f2" type="slide" axis="0 1 0"/>
        <inertial pos="0 0 0" mass=".2" diaginertia="1e-4 1e-4 1e-4"/></body>
    </body></body></worldbody>
  <equality><joint joint1="f2" joint2="f1" polycoef="0 -1 0 0 0"/>
    <connect body1="left" body2="right" anchor="0 0 0"/></equality>
  <actuator><position joint="shoulder" gear="2" forcerange="-10 10"/>
    <general joint="f1" biastype="affine" gainprm="300" biasprm="0 -300 -7" forcerange="-4 4"/></actuator>
</mujoco>"""


def test_an_mjcf_hand_follows_and_tells_its_gains(tmp_path: Path) -> None:
    path = tmp_path / "hand.xml"
    path.write_text(MJCF)
    arm, notes = notes_of(path)
    assert arm.joints == ("shoulder", "f1") and arm.sliding == (False, True)
    np.testing.assert_allclose(arm.armature, [0, 0.2])
    # about the joint: gear squared times the actuator's own gains
    assert "kp: [400, 300], kd: [20, 7]" in notes
    np.testing.assert_allclose(RigidBody(arm).effort_limits(), [20, 4])
    assert "several degrees of freedom" in notes
    assert notes.count("<equality>") == 1
    assert "<equality><connect> of left, right is not read" in notes


def test_links_may_be_called_like_their_joints(tmp_path: Path) -> None:
    renamed = ARM.replace("shoulder", "upper").replace("elbow", "lower")
    alike, other = (
        load_nominal_arm(robot(tmp_path / name, TORSO, parts), joints=[name])
        for name, parts in (("lower", renamed), ("elbow", ARM))
    )
    np.testing.assert_allclose(torque(alike), torque(other))


MESH = '<geometry><mesh filename="package://x/y.stl"/></geometry>'


def test_missing_meshes_stop_nothing_but_collisions(tmp_path: Path) -> None:
    shapes = f"<visual>{MESH}</visual><collision>{MESH}</collision></link>"
    arm = load_nominal_arm(robot(tmp_path, TORSO.replace("</link>", shapes), ARM))
    for name in ("a.urdf", "a.xml", "a.sdf"):
        export(CorrectedArm(arm, ()), tmp_path / "out" / name)
    assert torque(arm).shape == (20, 2)


def beside(kind: str, old: str = "", new: str = "") -> str:
    """A wheel that does not concern the arm, with something about it changed."""
    return joint("caster", "base", "roll", kind).replace(old, new) + link("roll")


BESIDE = {
    "a limit without effort": beside("continuous", LIMIT, '<limit velocity="2"/>'),
    "an empty limit": beside("revolute", LIMIT, "<limit/>"),
    "no limit": beside("revolute", LIMIT),
    "a limit in words": beside("revolute", '"-2"', '"low"'),
    "an unknown type": beside("universal"),
    "an axis of two numbers": beside("fixed", "0 1 0", "0 1"),
    "a mimic of nothing": beside("revolute", LIMIT, LIMIT + "<mimic/>"),
    "a link twice": link("roll") + beside("fixed"),
    "a link that hangs on nothing": link("tool changer"),
    "a joint to nowhere": joint("odd", "base", "nowhere"),
    "tags of simulators": '<gazebo reference="base"><x/></gazebo><material/><sensor/>',
    "meshes": f'<link name="a"><visual>{MESH}<material/></visual><collision/></link>',
}


@pytest.mark.parametrize("beside", BESIDE)
def test_what_does_not_concern_the_arm_is_not_read(
    beside: str, tmp_path: Path, silent: None
) -> None:
    sound, found = (
        load_nominal_arm(robot(tmp_path / name, BASE, ARM, more), **CHAIN)
        for name, more in (("sound", ""), ("odd", BESIDE[beside]))
    )
    np.testing.assert_array_equal(torque(found), torque(sound))


NO_LIMITS = {
    "effort": '<limit lower="-2" upper="2" velocity="2"/>',
    "velocity": '<limit lower="-2" upper="2" effort="50"/>',
    "effort and velocity": "",
}


@pytest.mark.parametrize("lacks", NO_LIMITS)
def test_a_limit_of_the_arm_that_is_not_given_is_none(
    lacks: str, tmp_path: Path, silent: None
) -> None:
    path = robot(tmp_path, TORSO, ARM.replace(LIMIT, NO_LIMITS[lacks], 1))
    said = f"<limit> does not say {lacks}: none"
    with pytest.warns(ModelWarning, match=f"shoulder: {said}"):
        body = RigidBody(load_nominal_arm(path))
    assert (body.effort_limits()[0] == 0) == ("effort" in lacks)
    assert (body.velocity_limits()[0] == 0) == ("velocity" in lacks)
    assert np.isinf(body.position_limits()[0][0]) == (not NO_LIMITS[lacks])


def test_known_robots_have_inertials_of_their_own_and_say_their_source() -> None:
    pytest.importorskip("pybullet_data", reason="the xarm6 comes with PyBullet")
    for name, known in KNOWN_ROBOTS.items():
        arm = load_nominal_arm(name)
        assert known.source and not placeholder(read_description(arm.urdf), arm.joints)
    # Gaz and others 2019, table of the identified masses
    mass = RigidBody(load_nominal_arm("franka_panda")).inertial_parameters()[::10]
    expected = [4.970684, 0.646926, 3.228604, 3.587895, 1.225946, 1.666555]
    np.testing.assert_allclose(mass[:6], expected, atol=1e-9)


def test_placeholders_of_an_engine_get_a_warning() -> None:
    folder = pybullet_data()
    if folder is None:
        pytest.skip("the placeholders come with PyBullet")
    with pytest.warns(ModelWarning, match="10 different masses have the same moments"):
        load_nominal_arm(folder / "franka_panda" / "panda.urdf")
