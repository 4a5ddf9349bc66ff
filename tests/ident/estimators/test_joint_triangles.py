"""Least squares on triangles of each joint, against least squares on the equations themselves."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.ident.estimators.joint_triangles import JointTriangles
from gapscope.ident.estimators.linear_estimator import joint_noise
from gapscope.ident.estimators.wls import WeightedLeastSquares
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.uncertainty.torque_interval import held_out

BETA = np.array([2.0, -1.0, 0.5, 3.0])


@pytest.fixture
def problem() -> Problem:
    """Three joints, the last of which the first two parameters do not move, in three groups."""
    rng = np.random.default_rng(4)
    matrix = rng.normal(size=(90, 3, 4))
    matrix[:, 2, :2] = 0.0
    noise = rng.normal(size=(90, 3)) * np.array([0.1, 1.0, 5.0])
    group = np.repeat(np.arange(3), 30)
    return Problem(matrix, matrix @ BETA + noise, tuple("abcd"), group, 0.01)


def test_they_keep_sums_of_squares_and_noise(problem: Problem) -> None:
    triangles = JointTriangles.of(problem)
    expected = (problem.residual(BETA) ** 2).sum(axis=0)
    np.testing.assert_allclose(triangles.squares(BETA), expected)
    np.testing.assert_allclose(triangles.noise(BETA), joint_noise(problem, BETA))
    parts = [JointTriangles.of(problem.rows(problem.group == g)) for g in range(3)]
    joined = JointTriangles.joined(parts)
    assert joined.samples == 90
    np.testing.assert_allclose(joined.squares(BETA), expected)


def test_the_estimate_is_that_of_weighted_equations(problem: Problem) -> None:
    """By numpy's least squares, with the noise of the rounds before."""
    found = WeightedLeastSquares().estimate(problem)
    matrix, torque = problem.stacked()
    beta = np.linalg.lstsq(matrix, torque, rcond=None)[0]
    for _ in range(2):
        weight = np.tile(1.0 / joint_noise(problem, beta), 90)
        weighed = matrix * weight[:, None], torque * weight
        beta, rest, _, _ = np.linalg.lstsq(*weighed, rcond=None)
    np.testing.assert_allclose(found.value, beta)
    precision = weighed[0].T @ weighed[0]
    covariance = rest[0] / (270 - 4) * np.linalg.inv(precision)
    np.testing.assert_allclose(found.covariance, covariance)


def test_held_out_groups_are_predicted_by_the_estimate_of_the_others(
    problem: Problem,
) -> None:
    residual = held_out(problem, WeightedLeastSquares())
    for group in range(3):
        own = problem.group == group
        value = WeightedLeastSquares().estimate(problem.rows(~own)).value
        expected = problem.rows(own).residual(value)
        np.testing.assert_allclose(residual[own], expected, rtol=1e-6)


def test_parameters_that_no_joint_shows_are_refused(problem: Problem) -> None:
    matrix = problem.matrix.copy()
    matrix[:, :, 3] = matrix[:, :, 2]
    same = Problem(matrix, problem.torque, problem.names, problem.group, 0.01)
    with pytest.raises(InputError, match="do not determine d"):
        WeightedLeastSquares().value(JointTriangles.of(same))
