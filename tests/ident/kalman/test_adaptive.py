"""A filter over stretches: least squares without drift, friction that wanders, honest bands, jumps."""

from __future__ import annotations

import numpy as np

from gapscope.ident.estimators.kalman import Kalman
from gapscope.ident.kalman.adaptive import Opening, follow
from gapscope.ident.model.linear_problem import Problem
from gapscope.model.effective_samples import variance_inflation

TRUTH = np.array([2.0, -1.0, 0.5, 3.0])
NAMES = ("m1", "mx1", "b1", "c1")


def made(
    seed: int,
    beta: np.ndarray = TRUTH,
    correlation: float = 0.0,
    samples: int = 1000,
) -> Problem:
    """Two joints over 20 s, noise of 0.1 and 0.3 N m; beta of shape (4,) or (N, 4)."""
    rng = np.random.default_rng(seed)
    W = rng.standard_normal((samples, 2, 4))
    noise = rng.standard_normal((samples, 2)) * [0.1, 0.3]
    for k in range(1, samples):
        noise[k] += correlation * noise[k - 1]
    W[:, :, 0] = np.cumsum(W[:, :, 0], axis=0) / np.sqrt(samples)
    beta = np.broadcast_to(beta, (samples, 4))
    torque = np.einsum("kja,ka->kj", W, beta) + noise
    group = np.arange(samples) * 2 // samples
    return Problem(W, torque, NAMES, group, 0.02)


def test_last_estimate_without_drift_is_that_of_weighted_least_squares() -> None:
    problem = made(0)
    found = follow(problem)
    assert found.level == 0.0
    sigma = found.noise * np.sqrt(found.inflation)
    W = (problem.matrix / sigma[:, None]).reshape(-1, 4)
    tau = (problem.torque / sigma).ravel()
    expected = np.linalg.lstsq(W, tau, rcond=None)[0]
    deviation = np.sqrt(np.diag(np.linalg.inv(W.T @ W)))
    np.testing.assert_allclose(
        found.track.value[-1], expected, atol=0.01 * deviation.min()
    )
    np.testing.assert_allclose(found.track.deviation[-1], deviation, rtol=0.01)


def test_intervals_hold_the_truth_under_coloured_noise() -> None:
    inside = []
    for seed in range(40):
        estimate = Kalman().estimate(made(seed, correlation=0.8))
        inside.append(np.abs(estimate.value - TRUTH) < 1.96 * estimate.deviation)
    assert np.mean(inside) > 0.93


def test_friction_that_warms_up_is_followed_and_masses_stay() -> None:
    count = 1000
    fading = np.exp(-np.arange(count) / 400)
    beta = np.tile(TRUTH, (count, 1))
    beta[:, 3] *= 1 + fading
    found = follow(made(1, beta))
    assert found.level > 0
    ends = [rows.stop - 1 for rows in found.stretches.rows]
    value, deviation = found.track.of("c1")
    late = len(ends) // 4
    error = np.abs(value - beta[ends, 3])[late:]
    assert np.mean(error < 3 * deviation[late:]) > 0.8
    assert error.max() < 0.15
    mass, _ = found.track.of("m1")
    assert abs(mass[-1] - TRUTH[0]) < 0.1


def test_innovations_of_a_right_model_are_noise() -> None:
    found = follow(made(2))
    late = found.innovation[300:]
    np.testing.assert_allclose(late.std(axis=0), 1.0, atol=0.1)
    assert (variance_inflation(late, np.zeros(len(late), dtype=int)) < 1.5).all()


def test_an_opening_lets_the_estimate_jump() -> None:
    count, moment = 1000, 600
    beta = np.tile(TRUTH, (count, 1))
    beta[moment:, 0] += 1.5
    problem = made(3, beta)
    covariance = np.diag([4.0, 0.0, 0.0, 0.0])
    opened = follow(problem, [Opening(moment, covariance)])
    mass, deviation = opened.track.of("m1")
    ends = np.array([rows.stop for rows in opened.stretches.rows])
    before, after = mass[ends <= moment][-1], mass[-1]
    assert abs(before - TRUTH[0]) < 4 * deviation[ends <= moment][-1]
    assert abs(after - TRUTH[0] - 1.5) < 4 * deviation[-1]
    # a filter that is not told stays off
    unaware, _ = follow(problem).track.of("m1")
    assert abs(unaware[-1] - TRUTH[0] - 1.5) > 0.1
