"""A small arm with boxes as collision shapes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.trajectory import Limits
from gapscope.arm.nominal import NominalArm

JOINT = """
  <joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
    <origin xyz="0 0 {height}"/><axis xyz="{axis}"/><limit lower="-2.5" upper="2.5" effort="60" velocity="3"/></joint>
  <link name="{child}"><inertial><mass value="3"/><origin xyz="0.02 0.01 0.2"/>
    <inertia ixx="0.05" iyy="0.06" izz="0.02" ixy="0.001" ixz="0.002" iyz="0.003"/></inertial>
    <collision><origin xyz="0 0 {middle}"/><geometry><box size="0.08 0.08 {length}"/></geometry></collision></link>"""
URDF = (
    '<robot name="three"><link name="base"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>'
    + JOINT.format(
        name="yaw",
        parent="base",
        child="first",
        height=0.2,
        axis="0 0 1",
        middle=0.0,
        length=0.1,
    )
    + JOINT.format(
        name="lift",
        parent="first",
        child="second",
        height=0.1,
        axis="0 1 0",
        middle=0.25,
        length=0.4,
    )
    + JOINT.format(
        name="bend",
        parent="second",
        child="third",
        height=0.5,
        axis="0 1 0",
        middle=0.325,
        length=0.55,
    )
    + "</robot>"
)
"""Axis of lift at 0.3 m, of bend 0.5 m beyond it; the third box reaches from 0.05 m to 0.6 m beyond bend."""


@pytest.fixture(scope="session")
def arm(tmp_path_factory: pytest.TempPathFactory) -> NominalArm:
    path: Path = tmp_path_factory.mktemp("arm") / "three.urdf"
    path.write_text(URDF)
    return NominalArm(
        "three",
        path,
        ("yaw", "lift", "bend"),
        armature=np.array([0.2, 0.1, 0.05]),
        viscous=np.array([1.0, 0.5, 0.2]),
        coulomb=np.array([1.0, 2.0, 0.5]),
    )


@pytest.fixture(scope="session")
def body(arm: NominalArm) -> RigidBody:
    return RigidBody(arm)


@pytest.fixture
def limits() -> Limits:
    return Limits(
        np.full(3, -2.0),
        np.array([2.0, 1.5, 2.0]),
        np.array([1.5, 1.0, 2.0]),
        np.array([5.0, 4.0, 8.0]),
    )
