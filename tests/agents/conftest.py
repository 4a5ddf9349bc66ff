"""Small arms: a pendulum with numbers that can be worked out by hand, and two joints."""

from __future__ import annotations

from pathlib import Path

import pytest
from arms import YAW_PITCH, chain, changed

from gapscope.arm.nominal import NominalArm

LINKS = {"inertia": "0.01 0.1 0.1", "limit": "-3 3 200 9"}
PENDULUM = changed([YAW_PITCH[1]], origin="0 0 1", **LINKS)


@pytest.fixture
def pendulum(tmp_path: Path) -> NominalArm:
    """2 kg at 0.5 m along x, 0.1 kg m^2 about its centre, a rotor of 0.4 kg m^2: 1 kg m^2 about its joint, along y."""
    return chain(tmp_path, "arm", *PENDULUM, armature=[0.4])


@pytest.fixture
def two(tmp_path: Path) -> NominalArm:
    """Two joints with rotors, friction and torque limits."""
    yaw, pitch = changed(YAW_PITCH, **LINKS)
    return chain(
        tmp_path,
        "arm",
        yaw,
        pitch._replace(origin="1 0 0.1"),
        armature=[0.5, 0.2],
        coulomb=[1.5, 1.0],
        viscous=[1.0, 1.0],
        torque_limit=[100.0, 60.0],
    )
