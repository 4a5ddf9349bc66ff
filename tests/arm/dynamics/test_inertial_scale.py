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


def test_errors_are_those_of_finite_changes_of_a_body() -> None:
    """Its mass takes all moments along, its centre the inertia about the joint; its shape is off by less."""
    body, units = parameters(MASS, CENTRE, INERTIA), np.ones(10)
    # the distance of the centre is read from the unit of the first moments
    units[1:4] = MASS * DISTANCE
    root = inertial_errors(body, units) * units[:, None]
    grown = parameters(1.01 * MASS, CENTRE, 1.01 * INERTIA)
    assert root[:, 0] == pytest.approx((grown - body) / 0.01)
    for axis, step in enumerate(1e-6 * np.eye(3)):
        ahead, behind = (parameters(MASS, CENTRE + s * step, INERTIA) for s in (1, -1))
        expected = (ahead - behind) / 2e-6 * DISTANCE / np.sqrt(3.0)
        assert root[:, 1 + axis] == pytest.approx(expected, abs=1e-7)
    # in pinocchio's order xx, xy, yy, xz, yz, zz
    shape = np.array([1.0, 0.5, 1.0, 0.5, 0.5, 1.0])
    size = SHAPE_ERROR * 0.5 * np.trace(INERTIA)
    assert np.diag(root)[4:] == pytest.approx(size * shape)
    # beside a body without mass
    both, scales = np.r_[np.zeros(10), body], np.r_[np.zeros(10), np.ones(10)]
    errors = inertial_errors(both, scales)
    assert not errors[:10].any() and not errors[:, :10].any()
    assert errors[10:, 10:].any()
