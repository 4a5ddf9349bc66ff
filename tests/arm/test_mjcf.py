"""An arm from an MJCF file is the arm from its URDF: inverse dynamics, limits and data sheet."""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from arm.dynamics import RigidBody
from arm.nominal import NominalArm
from arm.plain_mjcf import plain_mjcf
from arm.plain_urdf import moving_links
from arm.robots import KNOWN_ROBOTS, load_nominal_arm

SHEET = {"armature": "0.05", "frictionloss": "0.4", "damping": "0.3"}


def _numbers(text: str | None) -> np.ndarray:
    return np.array((text or "0 0 0").split(), dtype=float)


def _place(element: ET.Element, origin: ET.Element | None) -> None:
    """Pose of a URDF origin as pos and quat."""
    xyz, rpy = (None, None) if origin is None else (origin.get("xyz"), origin.get("rpy"))
    x, y, z, w = Rotation.from_euler("xyz", _numbers(rpy)).as_quat().tolist()
    element.set("pos", xyz or "0 0 0")
    element.set("quat", f"{w!r} {x!r} {y!r} {z!r}")


def written_as_mjcf(urdf: Path) -> str:
    """A serial URDF translated by hand, not by the project: nested bodies, degrees, full inertia, a default class."""
    robot = ET.parse(urdf).getroot()
    root = ET.Element("mujoco", model="translated")
    ET.SubElement(root, "compiler", angle="degree", autolimits="true")
    ET.SubElement(ET.SubElement(root, "default"), "joint", SHEET)
    bodies = {robot.findall("joint")[0].find("parent").get("link"): ET.SubElement(root, "worldbody")}
    for joint in robot.findall("joint"):
        child = joint.find("child").get("link")
        body = ET.SubElement(bodies[joint.find("parent").get("link")], "body", name=child)
        _place(body, joint.find("origin"))
        bodies[child] = body
        source = next(link for link in robot.findall("link") if link.get("name") == child).find("inertial")
        inertial = ET.SubElement(body, "inertial", mass=source.find("mass").get("value"))
        xyz = (source.find("origin").get("xyz") if source.find("origin") is not None else None) or "0 0 0"
        inertial.set("pos", xyz)
        moments = source.find("inertia")
        inertial.set("fullinertia", " ".join(moments.get(f"i{ij}") for ij in ("xx", "yy", "zz", "xy", "xz", "yz")))
        if joint.get("type") != "fixed":
            limit = [np.rad2deg(float(joint.find("limit").get(side))) for side in ("lower", "upper")]
            axis, reach = joint.find("axis").get("xyz"), f"{limit[0]:.17g} {limit[1]:.17g}"
            ET.SubElement(body, "joint", {"name": joint.get("name"), "axis": axis, "range": reach})
    return ET.tostring(root, encoding="unicode")


@pytest.fixture
def both(tmp_path: Path) -> tuple[NominalArm, NominalArm]:
    """The iiwa's seven joints from its URDF, and from the translation."""
    known = load_nominal_arm("kuka_iiwa")
    (tmp_path / "arm.xml").write_text(written_as_mjcf(known.urdf))
    return known, load_nominal_arm(tmp_path / "arm.xml")


def _samples(n: int) -> np.ndarray:
    """Positions, velocities and accelerations, shape (3, 50, n)."""
    return np.random.default_rng(0).uniform(-1.5, 1.5, (3, 50, n))


def test_seven_joints_have_the_inverse_dynamics_of_their_urdf(both: tuple[NominalArm, NominalArm]) -> None:
    known, read = both
    assert read.joints == known.joints and read.name == "translated"
    expected, found = (RigidBody(arm).inverse_dynamics(*_samples(7)) for arm in both)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    for ours, theirs in zip(RigidBody(read).position_limits(), RigidBody(known).position_limits(), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-12)


def test_rotors_and_friction_of_the_file_are_the_data_sheet(both: tuple[NominalArm, NominalArm]) -> None:
    read = both[1]
    for values, key in ((read.armature, "armature"), (read.coulomb, "frictionloss"), (read.viscous, "damping")):
        np.testing.assert_allclose(values, np.full(7, float(SHEET[key])))


def test_mujoco_reads_the_same_arm_from_it(both: tuple[NominalArm, NominalArm]) -> None:
    """Its inverse dynamics holds rotors and viscous friction too; dry friction is a constraint, taken out here."""
    mujoco = pytest.importorskip("mujoco")
    read, samples = both[1], _samples(7)
    model = mujoco.MjModel.from_xml_path(str(read.urdf))
    model.dof_frictionloss[:] = 0.0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    data = mujoco.MjData(model)
    expected = RigidBody(read).inverse_dynamics(*samples) + read.armature * samples[2] + read.viscous * samples[1]
    for q, dq, ddq, torque in zip(*samples, expected, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(data.qfrc_inverse, torque, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("robot", KNOWN_ROBOTS)
def test_what_is_written_for_mujoco_reads_back_as_the_same_arm(robot: str, tmp_path: Path) -> None:
    """Masses and moments, which are given to the engine after loading, are put into the text here."""
    body = RigidBody(load_nominal_arm(robot))
    links = moving_links(body)
    root = ET.fromstring(plain_mjcf(links, body.gravity, 1e-3))
    for inertial, link in zip(root.iter("inertial"), links, strict=True):
        inertial.set("mass", repr(link.mass))
        inertial.set("diaginertia", " ".join(repr(float(moment)) for moment in link.moments))
    (tmp_path / "plain.xml").write_text(ET.tostring(root, encoding="unicode"))
    back = RigidBody(load_nominal_arm(tmp_path / "plain.xml"))
    expected, found = (x.inverse_dynamics(*_samples(body.n_joints)) for x in (body, back))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
