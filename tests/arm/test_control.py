"""What a controller feeds forward, by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from arms import ROD, chain

from gapscope.arm.control import feedforward
from gapscope.arm.dynamics.rigid_body import RigidBody


def test_laws_by_hand(tmp_path: Path) -> None:
    """A rod of 2 kg at 0.5 m, inertia 0.55 kg m^2 about the hinge."""
    sheet = {"armature": [0.2], "coulomb": [3.0], "viscous": [0.7]}
    arm = chain(tmp_path, "pendulum", ROD, **sheet)
    q, dq, ddq = np.array([[0.0]]), np.array([[0.005]]), np.array([[2.0]])
    gravity = -9.81  # the rod points along x, gravity turns it about +y
    nominal = gravity + (0.55 + 0.2) * 2.0 + 3.0 * np.tanh(1.0) + 0.7 * 0.005
    for kind, expected in (("none", 0.0), ("gravity", gravity), ("nominal", nominal)):
        fed = feedforward(arm, RigidBody(arm), kind, q, dq, ddq)
        np.testing.assert_allclose(fed, [[expected]], rtol=1e-12)
