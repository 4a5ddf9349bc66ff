"""A pendulum and a two-joint arm, written out here, and a motion of each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm

LINK = """
  <joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
    <origin xyz="{origin}"/><axis xyz="{axis}"/><limit lower="-3" upper="3" effort="99" velocity="9"/></joint>
  <link name="{child}"><inertial><mass value="2"/><origin xyz="0.5 0 0"/>
    <inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
PENDULUM = (
    '<robot name="pendulum"><link name="base"/>'
    + LINK.format(
        name="hinge", parent="base", child="rod", origin="0 0 0", axis="0 1 0"
    )
    + "</robot>"
)
"""A rod of 2 kg, centre of mass 0.5 m from a horizontal axis: 0.55 kg m^2, gravity torque -9.81 cos q N m."""
TWO = (
    '<robot name="two"><link name="base"/>'
    + LINK.format(
        name="yaw", parent="base", child="upper", origin="0 0 0", axis="0 0 1"
    )
    + LINK.format(
        name="pitch", parent="upper", child="lower", origin="0.6 0 0.1", axis="0 1 0"
    )
    + "</robot>"
)


@pytest.fixture
def pendulum(tmp_path: Path) -> NominalArm:
    """The pendulum, without armature and friction."""
    urdf = tmp_path / "pendulum.urdf"
    urdf.write_text(PENDULUM)
    return NominalArm("pendulum", urdf, ("hinge",))


@pytest.fixture
def two(tmp_path: Path) -> NominalArm:
    """The two-joint arm, with a data sheet."""
    urdf = tmp_path / "two.urdf"
    urdf.write_text(TWO)
    sheet = {"armature": [0.3, 0.1], "coulomb": [1.0, 0.5], "viscous": [0.8, 0.4]}
    return NominalArm(
        "two",
        urdf,
        ("yaw", "pitch"),
        **{key: np.array(value) for key, value in sheet.items()},
    )


@pytest.fixture
def body(two: NominalArm) -> RigidBody:
    """Dynamics of the two-joint arm."""
    return RigidBody(two)


@pytest.fixture
def motion() -> Motion:
    """Two seconds of the two-joint arm at 250 Hz, both joints to and fro."""
    t = np.arange(500) / 250
    q = np.column_stack([np.sin(3 * t), 0.5 * np.cos(4 * t) + 0.2])
    dq = np.column_stack([3 * np.cos(3 * t), -2 * np.sin(4 * t)])
    return Motion(t, q, dq, np.column_stack([-9 * np.sin(3 * t), -8 * np.cos(4 * t)]))
