"""Gravity as the torque shows it, and the turn of the base that gives it."""

from __future__ import annotations

import numpy as np
import pytest
from diagnosis import synthetic
from diagnosis.synthetic import Truth

from gapscope.effects.environment import tilt
from gapscope.model.gravity_direction import (
    gravity_by_torque,
    turn_of_base,
)

DOWN = np.array([0.0, 0.0, -9.81])


@pytest.mark.parametrize(
    ("found", "turn"),
    [
        (-DOWN, (np.pi, 0.0)),
        ([0.0, 9.81, 0.0], (-np.pi / 2, 0.0)),
        ([9.81 * np.sin(0.5), 0.0, -9.81 * np.cos(0.5)], (0.0, 0.5)),
        (0.7 * (tilt(2.0, -0.8).T @ DOWN), (2.0, -0.8)),
    ],
)
def test_turn_of_known_directions(found: np.ndarray, turn: tuple[float, float]) -> None:
    roll, pitch = turn_of_base(DOWN, np.array(found)) or (np.nan, np.nan)
    # roll counts within a turn
    assert np.cos(roll - turn[0]) == pytest.approx(1.0, abs=1e-6)
    assert pitch == pytest.approx(turn[1], abs=1e-4)


@pytest.mark.parametrize("size", [0.0, 0.3, 3.0])
def test_a_vector_of_another_size_is_no_gravity(size: float) -> None:
    assert turn_of_base(DOWN, size * DOWN) is None


def test_a_small_tilt_is_no_turn() -> None:
    assert turn_of_base(DOWN, tilt(0.2, 0.2).T @ DOWN) is None


def test_an_arm_without_gravity_has_no_turn() -> None:
    assert turn_of_base(np.zeros(3), DOWN) is None


def test_gravity_is_found_beside_friction_and_offset() -> None:
    truth = Truth(
        tilt=(2.0, -0.8),
        coulomb=(3.0, 2.0, 1.0),
        viscous=(2.0, 4.0, 1.0),
        offset=(5.0, -3.0, 1.0),
    )
    path, t = synthetic.motion(7, 0.3, 8.0), np.arange(0.0, 8.0, 0.02)
    q, dq, ddq = path.position(t), path.velocity(t), path.acceleration(t)
    body, arm = synthetic.body(), synthetic.arm()
    regressor = body.gravity_regressor(q)
    without_gravity = (
        synthetic.needed(truth, path, t)
        - body.inverse_dynamics(q, dq, ddq)
        - arm.armature * ddq
        + regressor @ body.gravity
    )
    found = gravity_by_torque(without_gravity, regressor, dq, np.ones(3))
    np.testing.assert_allclose(found, tilt(2.0, -0.8).T @ DOWN, atol=0.2)
