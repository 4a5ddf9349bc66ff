"""A small arm with boxes as collision shapes."""

from __future__ import annotations

import numpy as np
import pytest
from arms import Link, chain

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.trajectory import Limits
from gapscope.arm.nominal import NominalArm

BASE = '<link name="base"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>'


def link(
    joint: str, name: str, axis: str, height: float, middle: float, length: float
) -> Link:
    """3 kg, with a box about a point ``middle`` above its joint [m]."""
    return Link(
        *(joint, name, axis, f"0 0 {height}"),
        mass=3,
        com="0.02 0.01 0.2",
        inertia="0.05 0.06 0.02 0.001 0.002 0.003",
        limit="-2.5 2.5 60 3",
        shape=f'<collision><origin xyz="0 0 {middle}"/><geometry><box size="0.08 0.08 {length}"/></geometry>'
        "</collision>",
    )


LINKS = (
    link("yaw", "first", "0 0 1", 0.2, 0.0, 0.1),
    link("lift", "second", "0 1 0", 0.1, 0.25, 0.4),
    link("bend", "third", "0 1 0", 0.5, 0.325, 0.55),
)
"""Axis of lift at 0.3 m, of bend 0.5 m beyond it; the third box reaches from 0.05 m to 0.6 m beyond bend."""


@pytest.fixture(scope="session")
def arm(tmp_path_factory: pytest.TempPathFactory) -> NominalArm:
    return chain(
        tmp_path_factory.mktemp("arm"),
        "three",
        *LINKS,
        base=BASE,
        armature=[0.2, 0.1, 0.05],
        viscous=[1.0, 0.5, 0.2],
        coulomb=[1.0, 2.0, 0.5],
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
