"""A pendulum and a two-joint arm, and a motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arms import ROD, YAW_PITCH, chain, changed
from cases import to_and_fro

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm


@pytest.fixture
def pendulum(tmp_path: Path) -> NominalArm:
    """The pendulum, without armature and friction."""
    return chain(
        tmp_path, "pendulum", *changed([ROD], kind="revolute", limit="-3 3 99 9")
    )


@pytest.fixture
def two(tmp_path: Path) -> NominalArm:
    """The two-joint arm, with a data sheet."""
    return chain(
        tmp_path,
        "two",
        *YAW_PITCH,
        armature=[0.3, 0.1],
        coulomb=[1.0, 0.5],
        viscous=[0.8, 0.4],
    )


@pytest.fixture
def body(two: NominalArm) -> RigidBody:
    """Dynamics of the two-joint arm."""
    return RigidBody(two)


@pytest.fixture
def motion() -> Motion:
    """Two seconds of the two-joint arm at 250 Hz, both joints to and fro."""
    t = np.arange(500) / 250
    q, dq = to_and_fro(t)
    q[:, 1] += 0.2
    return Motion(t, q, dq, np.column_stack([-9 * np.sin(3 * t), -8 * np.cos(4 * t)]))
