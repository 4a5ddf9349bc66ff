"""An arm from an MJCF file is the arm from its URDF, and nothing of the file is changed or left out without a word."""

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from sweeps import daily

from gapscope.arm.dynamics.plain_urdf import moving_links, plain_mjcf
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import KNOWN_ROBOTS, load_nominal_arm

Load = Callable[..., NominalArm]
INERTIAL = '<inertial pos="0 0 0.2" mass="2" diaginertia="0.1 0.1 0.02"/>'


def _samples(n: int) -> np.ndarray:
    """Positions, velocities and accelerations, shape (3, 50, n)."""
    return np.random.default_rng(0).uniform(-1.5, 1.5, (3, 50, n))


@pytest.mark.parametrize("robot", daily(KNOWN_ROBOTS, "franka_panda"))
def test_what_is_written_for_mujoco_reads_back(robot: str, load: Load) -> None:
    """Masses and moments, which are given to the engine after loading, are put into the text here."""
    body = RigidBody(load_nominal_arm(robot))
    links = moving_links(body)
    root = ET.fromstring(plain_mjcf(links, body.gravity, 1e-3))
    for inertial, link in zip(root.iter("inertial"), links, strict=True):
        inertial.set("mass", repr(link.mass))
        inertial.set("diaginertia", " ".join(map(repr, link.moments.tolist())))
    back = RigidBody(load(ET.tostring(root, encoding="unicode")))
    samples = _samples(body.n_joints)
    expected, found = (x.inverse_dynamics(*samples) for x in (body, back))
    size = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * size)


@pytest.fixture
def load(tmp_path: Path) -> Load:
    """An arm of one joint from MJCF, with this and that in it; or of a whole text."""

    def of(text="", *, inside="", inertial=INERTIAL, before="", joint="", after=""):
        one = (
            f'<mujoco model="one"><compiler angle="radian"/>{before}<worldbody><body name="rod">{inertial}'
            f'<joint name="hinge" axis="0 1 0" {joint}/>{inside}</body></worldbody>{after}</mujoco>'
        )
        (tmp_path / "one.xml").write_text(text or one)
        return load_nominal_arm(tmp_path / "one.xml")

    return of


MESH = '<asset><mesh name="hull" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>'


def changed(old: str, new: str) -> str:
    """The inertial of the rod with something else in it."""
    assert old in INERTIAL
    return INERTIAL.replace(old, new)


SIX = '<inertial pos="0 0 0" mass="1" fullinertia="0.1 0.1 0.1 0.3 0 0"/>'
BY_MESH = {"inertial": '<geom type="mesh" mesh="hull"/>', "before": MESH}
ROD = "line 1, body rod, <inertial"
MOMENTS = f"{ROD}>: it has the principal moments"
REFUSED: list[tuple[dict[str, str], str]] = [
    ({"inertial": changed('"2"', '"-2"')}, f"{ROD}>: mass is -2 kg"),
    ({"inertial": changed('"2"', '"two"')}, "line 1, <inertial>: is not valid MJCF: bad format in attribute 'mass'"),
    ({"inertial": changed('"2"', '"nan"')}, "line 1, <inertial mass>: expected numbers, got 'nan'"),
    ({"inertial": changed('mass="2"', "")}, "<inertial>: is not valid MJCF: required attribute missing: 'mass'"),
    ({"inertial": '<inertial pos="0 0 0" mass="1"/>'}, "has no diaginertia"),
    ({"inertial": changed("0.1 0.1", "-0.1 0.1")}, f"{MOMENTS} -0.1, 0.02, 0.1 kg m^2"),
    ({"inertial": SIX}, f"{MOMENTS} -0.2, 0.1, 0.4 kg m^2"),
    (BY_MESH, "body rod: has no <inertial>, and its mass cannot be taken from the"),
    ({"before": '<include file="more.xml"/>'}, "<include> is not read"),
    ({"before": '<option gravity="0 -9.81"/>'}, "<option>: is not valid MJCF: attribute 'gravity' does not have"),
    ({"joint": 'ref="0.2"'}, "joint hinge: ref is 0.2, expected 0"),
    ({"joint": 'class="none"'}, "<joint>: is not valid MJCF: unknown default class name 'none'"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "message"), REFUSED)
def test_what_would_be_read_as_something_else_is_refused(
    load: Load, tmp_path: Path, change: dict[str, str], message: str
) -> None:
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        load(**change)
    assert caught.value.file == tmp_path / "one.xml" and caught.value.remedy


CLASSES = (
    '<default><joint stiffness="3"/><motor ctrlrange="-9 9"/>'
    '<default class="soft"><joint stiffness="5"/><motor ctrlrange="-2 2"/></default></default>'
)
SPRING = "the spring of joint hinge (stiffness"
EQUALITY = '<equality><joint joint1="hinge"/></equality>'
LEFT_OUT: list[tuple[dict[str, str], str]] = [
    ({"joint": 'stiffness="5" springref="0.3"'}, f"{SPRING} 5, springref 0.3)"),
    ({"before": CLASSES}, f"{SPRING} 3, springref 0)"),
    ({"before": CLASSES, "joint": 'class="soft"'}, f"{SPRING} 5"),
    ({"after": '<actuator><velocity joint="hinge" kv="3"/></actuator>'}, "controller: of a case, kp: [0], kd: [3]"),
    ({"after": EQUALITY}, "<equality><joint> of hinge is not read"),
    ({"inside": '<body name="tip" gravcomp="1"/>'}, "gravcomp of body tip is not read"),
    ({"joint": 'springdamper="0.1 1"'}, "springdamper of joint hinge is not read"),
    ({"inertial": '<geom size="0.1" shellinertia="true"/>'}, "shellinertia of body rod is not read"),
    ({"before": '<compiler boundmass="0.1"/>'}, "<compiler boundmass> is not read"),
    ({"before": '<compiler boundinertia="0.1"/>'}, "<compiler boundinertia> is not read"),
    ({"before": '<compiler balanceinertia="true"/>'}, "<compiler balanceinertia> is not read"),
    ({"inertial": '<geom size="0.1"/>'}, "body rod has no <inertial> and is weighed by its shapes"),
]  # fmt: skip


@pytest.mark.filterwarnings("ignore::gapscope.arm.errors.ModelWarning")
def test_shapes_of_other_groups_weigh_nothing(load: Load) -> None:
    """Neither a sphere beside the one that weighs, nor a mesh."""
    weighs = '<geom size="0.1" pos="0 0 0.2"/>'
    idle = '<geom size="0.3" group="3"/><geom type="mesh" mesh="hull" group="2"/>'
    before = MESH + '<compiler inertiagrouprange="0 1"/>'
    expected, found = (
        RigidBody(load(inertial=x, before=before)) for x in (weighs, weighs + idle)
    )
    masses = found.inertial_parameters()
    np.testing.assert_array_equal(masses, expected.inertial_parameters())


@pytest.mark.parametrize(("change", "message"), LEFT_OUT)
@pytest.mark.filterwarnings("always::gapscope.arm.errors.ModelWarning")
def test_what_is_left_out_is_told(
    load: Load, change: dict[str, str], message: str
) -> None:
    with pytest.warns(ModelWarning, match=re.escape(message)):
        load(**change)


GRAVITY = {
    '<option gravity="0 0 -1.62"/>': [0, 0, -1.62],
    '<option><flag gravity="disable"/></option>': [0, 0, 0],
    "": [0, 0, -9.81],
}


@pytest.mark.parametrize("option", GRAVITY)
def test_gravity_of_the_file_counts_if_nothing_else_is_said(
    option: str, load: Load
) -> None:
    read = load(before=option)
    np.testing.assert_array_equal(read.gravity, GRAVITY[option])
    given = load_nominal_arm(read.urdf, gravity=[0, 0, -3.7])
    np.testing.assert_array_equal(given.gravity, [0, 0, -3.7])


CLAMPED = 'actuatorfrcrange="-7 7"'
TORQUES = [
    ("", "", 0.0),
    (CLAMPED, "", 7.0),
    ("", 'motor ctrlrange="-3 4" gear="2"', 6.0),
    ("", 'motor ctrlrange="-3 3" ctrllimited="false"', 0.0),
    ("", 'general ctrlrange="-3 3" gainprm="10"', 30.0),
    ("", 'position ctrlrange="-1 1" forcerange="-4 4"', 4.0),
    ("", 'motor class="soft"', 2.0),
    (CLAMPED, 'motor ctrllimited="false" gear="3"', 7.0),
]
"""What is said of joint and actuator, and the limit of torque [N m]."""


@pytest.mark.parametrize(("joint", "actuator", "limit"), TORQUES)
def test_torque_limit_of_joint_and_actuator(
    load: Load, joint: str, actuator: str, limit: float
) -> None:
    """As ``effort`` of a URDF, 0 where there is none."""
    before = CLASSES if "soft" in actuator else ""
    after = f'<actuator><{actuator} joint="hinge"/></actuator>' if actuator else ""
    body = RigidBody(load(joint=joint, before=before, after=after))
    assert body.effort_limits() == pytest.approx([limit])
    assert body.velocity_limits() == pytest.approx([0.0])


def test_rotors_and_friction_and_a_body_without_a_name(load: Load) -> None:
    """Of classes in the file, and fixed to the rod or turning on it."""
    own = '<default><joint armature="0.05" frictionloss="0.4" damping="0.3"/></default>'
    read = load(inside=f"<body>{INERTIAL}</body>", before=own)
    assert (read.armature, read.coulomb, read.viscous) == (0.05, 0.4, 0.3)
    assert RigidBody(read).inertial_parameters()[0] == 4.0
    turning = load(inside=f'<body>{INERTIAL}<joint name="tip"/></body>')
    assert turning.joints == ("hinge", "tip")


TURNS = ('xyaxes="1 0 0 0 0 1"', 'zaxis="0 -1 0"', 'euler="1.5708 0 0"')
"""Ways to say a right angle about x."""


@pytest.mark.parametrize("turn", TURNS)
def test_several_joints_of_one_body_and_ways_to_say_a_turn_are_those_of_mujoco(
    turn: str, load: Load
) -> None:
    mujoco = pytest.importorskip("mujoco")
    other = f'<body name="arm" pos="0 0 0.3" {turn}><joint name="lift" type="slide"/>'
    # xx yy zz xy xz yz
    full = INERTIAL.replace("diaginertia", "fullinertia")
    full = full.replace("0.02", "0.09 .01 .02 .03")
    second = f'<joint name="tilt" pos="0 0.1 0" axis="1 0 0"/>{full}'
    # two more bodies, which are only there once frame and replicate are resolved
    more = f'<replicate count="2" offset="0.1 0 0"><body>{INERTIAL}</body></replicate>'
    framed = f'<frame pos="0 0.2 0" {turn}>{other}{second}{more}</body></frame>'
    read = load(inside=framed)
    assert read.joints == ("hinge", "lift", "tilt")
    model = mujoco.MjModel.from_xml_path(str(read.urdf))
    data, samples, expected = mujoco.MjData(model), _samples(3), []
    for data.qpos[:], data.qvel[:], data.qacc[:] in zip(*samples, strict=True):
        mujoco.mj_inverse(model, data)
        expected.append(data.qfrc_inverse.copy())
    found = RigidBody(read).inverse_dynamics(*samples)
    np.testing.assert_allclose(found, expected, atol=1e-8)
