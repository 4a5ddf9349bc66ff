"""A two-joint arm with friction in its URDF, a recording of it, and a way to write files of text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm

JOINT = """
  <joint name="{name}" type="revolute">
    <parent link="{parent}"/><child link="{child}"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="10" velocity="3"/>
    <dynamics damping="{damping}" friction="{friction}"/>
  </joint>
  <link name="{child}">
    <inertial><mass value="1"/><origin xyz="0 0 0.2"/>
      <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>"""

URDF = (
    '<robot name="two"><link name="base"/>'
    + JOINT.format(
        name="shoulder", parent="base", child="upper", damping=0.5, friction=0.25
    )
    + JOINT.format(name="elbow", parent="upper", child="lower", damping=0.1, friction=0)
    + "</robot>"
)


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    """URDF of the two-joint arm."""
    path = tmp_path / "robot.urdf"
    path.write_text(URDF)
    return path


@pytest.fixture
def arm(urdf: Path) -> NominalArm:
    """The two-joint arm."""
    return load_nominal_arm(urdf)


@pytest.fixture
def recording() -> Recording:
    """Two seconds at 100 Hz with every channel, both joints moving to and fro."""
    t = np.arange(200) / 100
    q = np.column_stack([np.sin(3 * t), 0.5 * np.cos(4 * t)])
    dq = np.column_stack([3 * np.cos(3 * t), -2 * np.sin(4 * t)])
    noise = np.random.default_rng(1).normal(size=(200, 2))
    return Recording(
        "motion.csv",
        t,
        q,
        dq + noise,
        dq,
        q + 0.01,
        dq + 0.01,
        dq + 2 * noise,
        30 + 0.1 * noise,
    )
