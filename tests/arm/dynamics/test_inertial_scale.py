"""Errors of bodies, against finite changes of pinocchio's inertias."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from gapscope.arm.dynamics.inertials import SHAPE_ERROR, inertial_errors

MASS = 2.0
CENTRE = np.array([0.1, -0.05, 0.2])
INERTIA = np.array([[0.03, 0.002, 0.0], [0.002, 0.02, -0.001], [0.0, -0.001, 0.01]])
DISTANCE = float(np.linalg.norm(CENTRE))


def parameters(mass: float, centre: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    return np.asarray(pin.Inertia(mass, centre, inertia).toDynamicParameters())


@pytest.fixture
def root() -> np.ndarray:
    """Columns of one body's errors in SI units, (10, 10)."""
    units = np.ones(10)
    # the distance of the centre is read from the unit of the first moments
    units[1:4] = MASS * DISTANCE
    own = inertial_errors(parameters(MASS, CENTRE, INERTIA), units)
    return np.asarray(own * units[:, None])


def test_a_wrong_mass_takes_all_moments_along(root: np.ndarray) -> None:
    grown = parameters(1.01 * MASS, CENTRE, 1.01 * INERTIA)
    expected = (grown - parameters(MASS, CENTRE, INERTIA)) / 0.01
    assert root[:, 0] == pytest.approx(expected)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_centre_that_is_off_moves_the_inertia_about_the_joint(
    root: np.ndarray, axis: int
) -> None:
    step = 1e-6 * np.eye(3)[axis]
    ahead, behind = (parameters(MASS, CENTRE + way, INERTIA) for way in (step, -step))
    expected = (ahead - behind) / 2e-6 * DISTANCE / np.sqrt(3.0)
    assert root[:, 1 + axis] == pytest.approx(expected, abs=1e-7)


def test_the_shape_of_the_inertia_is_off_by_less(root: np.ndarray) -> None:
    size = SHAPE_ERROR * 0.5 * np.trace(INERTIA)
    # in pinocchio's order xx, xy, yy, xz, yz, zz
    expected = size * np.array([1.0, 0.5, 1.0, 0.5, 0.5, 1.0])
    assert np.diag(root)[4:] == pytest.approx(expected)


def test_a_body_without_mass_has_no_error() -> None:
    both = np.concatenate([np.zeros(10), parameters(MASS, CENTRE, INERTIA)])
    units = np.concatenate([np.zeros(10), np.ones(10)])
    errors = inertial_errors(both, units)
    assert not errors[:10].any() and not errors[:, :10].any()
    assert errors[10:, 10:].any()
