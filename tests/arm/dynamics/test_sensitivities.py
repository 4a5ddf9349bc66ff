"""Derivatives of the inverse dynamics against finite differences, for bodies as least squares may return them."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.robots import load_nominal_arm

STEP = 1e-6


@pytest.mark.parametrize("negative", [(), (2, 3, 4, 5)])
def test_derivatives_are_those_of_the_inverse_dynamics_whatever_the_masses(
    negative: tuple[int, ...],
) -> None:
    """Identified masses may be negative: single parameters of a fit are not determined."""
    nominal = RigidBody(load_nominal_arm("kuka_iiwa"))
    rng = np.random.default_rng(0)
    change = 0.05 * rng.standard_normal((7, 10))
    change[list(negative), 0] -= 9.0
    body = nominal.changed(change)
    q, dq, ddq = rng.standard_normal((3, 2, 7))
    by_position, by_velocity, mass = body.sensitivities(q, dq, ddq)
    for j, step in enumerate(STEP * np.eye(7)):
        for derivative, along in (
            (by_position, (step, 0, 0)),
            (by_velocity, (0, step, 0)),
            (mass, (0, 0, step)),
        ):
            ahead = body.inverse_dynamics(q + along[0], dq + along[1], ddq + along[2])
            behind = body.inverse_dynamics(q - along[0], dq - along[1], ddq - along[2])
            central = (ahead - behind) / (2 * STEP)
            assert derivative[:, :, j] == pytest.approx(central, abs=1e-5)
