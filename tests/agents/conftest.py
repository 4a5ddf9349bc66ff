"""Small arms: a pendulum with numbers that can be worked out by hand, and two joints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.nominal import NominalArm

JOINT = """
  <joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
    <origin xyz="{origin}"/><axis xyz="{axis}"/><limit lower="-3" upper="3" effort="200" velocity="9"/></joint>
  <link name="{child}"><inertial><mass value="2"/><origin xyz="0.5 0 0"/>
    <inertia ixx="0.01" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
PENDULUM = (
    '<robot name="pendulum"><link name="base"/>'
    + JOINT.format(
        name="pitch", parent="base", child="link", origin="0 0 1", axis="0 1 0"
    )
    + "</robot>"
)
TWO = (
    '<robot name="two"><link name="base"/>'
    + JOINT.format(
        name="yaw", parent="base", child="upper", origin="0 0 0", axis="0 0 1"
    )
    + JOINT.format(
        name="pitch", parent="upper", child="lower", origin="1 0 0.1", axis="0 1 0"
    )
    + "</robot>"
)


def _arm(
    folder: Path, text: str, joints: tuple[str, ...], **sheet: np.ndarray
) -> NominalArm:
    urdf = folder / "robot.urdf"
    urdf.write_text(text)
    return NominalArm("arm", urdf, joints, **sheet)


@pytest.fixture
def pendulum(tmp_path: Path) -> NominalArm:
    """2 kg at 0.5 m along x, 0.1 kg m^2 about its centre, a rotor of 0.4 kg m^2: 1 kg m^2 about its joint, along y."""
    return _arm(tmp_path, PENDULUM, ("pitch",), armature=np.array([0.4]))


@pytest.fixture
def floating(tmp_path: Path) -> NominalArm:
    """The pendulum without gravity."""
    return _arm(
        tmp_path, PENDULUM, ("pitch",), armature=np.array([0.4]), gravity=np.zeros(3)
    )


@pytest.fixture
def two(tmp_path: Path) -> NominalArm:
    """Two joints with rotors, friction and torque limits."""
    sheet = {
        "armature": [0.5, 0.2],
        "coulomb": [1.5, 1.0],
        "viscous": [1.0, 1.0],
        "torque_limit": [100.0, 60.0],
    }
    return _arm(
        tmp_path,
        TWO,
        ("yaw", "pitch"),
        **{name: np.array(value) for name, value in sheet.items()},
    )
