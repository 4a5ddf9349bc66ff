"""The feedforward law, on a pendulum worked by hand."""

from pathlib import Path

import numpy as np
import pytest
from arms import ROD, chain

from gapscope.arm.dynamics.feedforward import feedforward
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm


@pytest.fixture
def arm(tmp_path: Path) -> NominalArm:
    """2 kg at 0.5 m, inertia 0.55 kg m^2 about the hinge."""
    return chain(
        tmp_path, "pendulum", ROD, armature=[0.2], coulomb=[3.0], viscous=[0.7]
    )


def test_laws_by_hand(arm: NominalArm) -> None:
    q, dq, ddq = np.array([[0.0]]), np.array([[0.005]]), np.array([[2.0]])
    gravity = -9.81  # the rod points along x, gravity turns it about +y
    nominal = gravity + (0.55 + 0.2) * 2.0 + 3.0 * np.tanh(1.0) + 0.7 * 0.005
    for kind, expected in (("none", 0.0), ("gravity", gravity), ("nominal", nominal)):
        np.testing.assert_allclose(
            feedforward(arm, RigidBody(arm), kind, q, dq, ddq), [[expected]], rtol=1e-12
        )


def test_unknown_kind(arm: NominalArm) -> None:
    with pytest.raises(InputError, match=r"controller\.feedforward"):
        feedforward(arm, RigidBody(arm), "magic", *np.zeros((3, 1, 1)))
