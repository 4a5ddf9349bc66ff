"""Streaming least squares: the same as factoring all rows at once, whatever the chunks."""

import tracemalloc

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.arm.robots import load_nominal_arm
from gapscope.ident.model.base_parameters import random_states, structural_base
from gapscope.ident.model.regressor import Regressor
from gapscope.ident.model.tsqr import ROWS, JointFactors, TriangularFactor, factored


@pytest.fixture
def problem():
    rng = np.random.default_rng(0)
    W = rng.standard_normal((3 * ROWS + 17, 12)) * 10 ** rng.uniform(-3, 3, 12)
    return W, W @ rng.uniform(1, 2, 12) + rng.standard_normal(len(W))


def streamed(W, tau, chunk) -> TriangularFactor:
    factor = TriangularFactor(W.shape[1])
    for start in range(0, len(W), chunk):
        factor.add(W[start : start + chunk], tau[start : start + chunk])
    return factor


def assert_same(factor, W, tau):
    """R^T R = W^T W, R^T z = W^T tau, and the least-squares solution, relative to the size of each."""
    R, scale = factor.triangle, np.linalg.norm(W, axis=0)
    assert np.array_equal(R, np.triu(R))
    assert np.allclose(
        R.T @ R / np.outer(scale, scale),
        W.T @ W / np.outer(scale, scale),
        rtol=0,
        atol=1e-12,
    )
    size = scale * np.linalg.norm(tau)
    assert np.allclose(
        R.T @ factor.projected / size, W.T @ tau / size, rtol=0, atol=1e-12
    )
    beta, square = np.linalg.lstsq(W, tau, rcond=None)[:2]
    assert np.linalg.norm(factor.solve() - beta) < 1e-10 * np.linalg.norm(beta)
    assert factor.residual_norm**2 == pytest.approx(square[0], rel=1e-10)
    assert factor.rows == len(W)


@pytest.mark.parametrize("chunk", [1, 5, 700, ROWS, 10**6])
def test_least_squares_of_a_stream_is_that_of_all_rows(problem, chunk):
    W, tau = problem if chunk > 5 else (problem[0][:300], problem[1][:300])
    assert_same(streamed(W, tau, chunk), W, tau)


def test_merged_factors_are_the_factor_of_all_rows(problem):
    W, tau = problem
    first, second = (
        streamed(W[:1000], tau[:1000], 300),
        streamed(W[1000:], tau[1000:], 450),
    )
    first.merge(second)
    assert_same(first, W, tau)


def test_factor_of_some_columns(problem):
    W, tau = problem
    columns = [7, 2, 11]
    assert_same(streamed(W, tau, 500).select(columns), W[:, columns], tau)


def test_scaled_factor_is_that_of_weighted_rows(problem):
    W, tau = problem
    assert_same(streamed(W, tau, 500).scaled(-2.5), 2.5 * W, 2.5 * tau)


def test_covariance_is_the_textbook_formula(problem):
    W, tau = problem
    beta = np.linalg.lstsq(W, tau, rcond=None)[0]
    expected = np.sum((tau - W @ beta) ** 2) / (len(W) - 12) * np.linalg.inv(W.T @ W)
    assert np.allclose(streamed(W, tau, 500).covariance(), expected, rtol=1e-9, atol=0)


def test_dependent_columns_give_the_shortest_solution():
    rng = np.random.default_rng(1)
    W = rng.standard_normal((50, 3)) @ np.array(
        [[1.0, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 1]]
    )
    tau = rng.standard_normal(50)
    assert np.allclose(
        streamed(W, tau, 10).solve(),
        np.linalg.lstsq(W, tau, rcond=1e-12)[0],
        rtol=0,
        atol=1e-12,
    )


def test_orthogonal_factor_keeps_what_the_normal_equations_lose():
    # singular values 1 and 1e-9: their squares are beyond double precision
    rng = np.random.default_rng(2)
    left, right = (
        np.linalg.qr(rng.standard_normal((5000, 2)))[0],
        np.linalg.qr(rng.standard_normal((2, 2)))[0],
    )
    W = left * [1.0, 1e-9] @ right.T
    beta = streamed(W, W @ [1.0, -2.0], 400).solve()
    assert np.allclose(beta, [1.0, -2.0], rtol=0, atol=1e-5)


@pytest.fixture(scope="module")
def iiwa():
    regressor = Regressor(load_nominal_arm("kuka_iiwa"))
    states = random_states(regressor, np.random.default_rng(3), 400)
    Y = regressor.matrix(states)
    tau = Y @ regressor.nominal() + np.random.default_rng(4).standard_normal(
        (400, 7)
    ) * np.arange(1, 8)
    return regressor, Y, tau


def test_factors_of_joints_stacked_with_weights_solve_the_weighted_problem(iiwa):
    regressor, Y, tau = iiwa
    base = structural_base(regressor, np.random.default_rng(5))
    joints = JointFactors(regressor.support)
    for start in range(0, 400, 90):
        joints.add(Y[start : start + 90], tau[start : start + 90])
    weights = 1.0 / np.arange(1, 8)
    rows = (Y[:, :, base.kept] * weights[:, None]).reshape(-1, base.count)
    assert_same(
        joints.stacked(weights).select(base.kept), rows, (tau * weights).ravel()
    )
    plain = Y[:, :, base.kept].reshape(-1, base.count)
    assert_same(joints.stacked().select(base.kept), plain, tau.ravel())


def test_factors_of_joints_merge(iiwa):
    regressor, Y, tau = iiwa
    parts = [JointFactors(regressor.support) for _ in range(2)]
    parts[0].add(Y[:150], tau[:150])
    parts[1].add(Y[150:], tau[150:])
    parts[0].merge(parts[1])
    whole = JointFactors(regressor.support)
    whole.add(Y, tau)
    for merged, direct in zip(parts[0].joints, whole.joints, strict=True):
        assert merged.rows == direct.rows == 400
        products = [factor.triangle.T @ factor.triangle for factor in (merged, direct)]
        assert np.allclose(*products, rtol=0, atol=1e-12 * np.abs(products[0]).max())
        assert merged.residual_norm == pytest.approx(direct.residual_norm, rel=1e-8)


@pytest.mark.parametrize("samples", [60, ROWS + 30])
def test_factors_of_a_motion_are_those_of_its_regressor(iiwa, samples):
    regressor = iiwa[0]
    states = random_states(regressor, np.random.default_rng(6), samples)
    Y, tau = (
        regressor.matrix(states),
        np.random.default_rng(7).standard_normal((samples, 7)),
    )
    stacked = factored(regressor, states, tau).stacked()
    base = structural_base(regressor, np.random.default_rng(8))
    assert_same(
        stacked.select(base.kept),
        Y[:, :, base.kept].reshape(-1, base.count),
        tau.ravel(),
    )


def test_memory_does_not_grow_with_the_number_of_rows(problem):
    W, tau = (x[:ROWS] for x in problem)
    factor = TriangularFactor(12)
    factor.add(W, tau)
    tracemalloc.start()
    peaks = []
    for repeats in (5, 50):
        tracemalloc.reset_peak()
        for _ in range(repeats):
            factor.add(W, tau)
        peaks.append(tracemalloc.get_traced_memory()[1])
    tracemalloc.stop()
    assert factor.rows == 56 * ROWS
    assert peaks[1] < 1.1 * peaks[0]


BAD = {
    "columns": (np.ones((4, 3)), None, "expected 2 columns, got 3"),
    "torques": (np.ones((4, 2)), np.ones(5), "4 rows of the regressor, but 5 torques"),
    "NaN in the regressor": (np.full((4, 2), np.nan), None, "not finite"),
    "NaN in the torque": (np.eye(4, 2), np.full(4, np.nan), "not finite"),
}


@pytest.mark.parametrize(("W", "tau", "message"), BAD.values(), ids=BAD)
def test_bad_rows_are_refused(W, tau, message):
    with pytest.raises(InputError, match=message):
        TriangularFactor(2).add(W, tau)


def test_refused_rows_leave_the_factor_as_it_was(problem):
    W, tau = problem
    factor = streamed(W, tau, 500)
    with pytest.raises(InputError, match="not finite"):
        factor.add(np.full((3, 12), np.inf))
    assert_same(factor, W, tau)
