"""Pseudo-inertia: what a body of point masses has, and coordinates in which every body is physical."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gapscope.ident.model.pseudo_inertia import (
    central_inertia,
    divergence,
    from_log_cholesky,
    inertial_parameters,
    is_consistent,
    log_cholesky_jacobian,
    pseudo_inertia,
    to_log_cholesky,
    triangle_inequality,
)

THETA = arrays(float, 10, elements=st.floats(-1.5, 1.5))
BALL = np.array([2.0, 0, 0, 0, 0.1, 0, 0.1, 0, 0, 0.1])


def of_points(masses: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Parameters of point masses [kg] at places [m], by the definitions m, m c, and I = sum m (r.r 1 - r r^T)."""
    inertia = sum(
        m * (r @ r * np.eye(3) - np.outer(r, r))
        for m, r in zip(masses, places, strict=True)
    )
    moment = masses @ places
    i, j = [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]
    return np.concatenate([[masses.sum()], moment, inertia[i, j]])


def test_second_moments_of_point_masses() -> None:
    """J = sum m (r, 1) (r, 1)^T."""
    rng = np.random.default_rng(0)
    masses, places = rng.uniform(0.1, 1.0, 6), rng.standard_normal((6, 3))
    ones = np.column_stack([places, np.ones(6)])
    expected = np.einsum("k,ka,kb->ab", masses, ones, ones)
    found = of_points(masses, places)
    assert np.allclose(pseudo_inertia(found), expected)
    assert np.allclose(inertial_parameters(expected), found)
    assert is_consistent(found) and triangle_inequality(found)


@given(THETA)
def test_log_cholesky_there_and_back(theta: np.ndarray) -> None:
    parameters = from_log_cholesky(theta)
    assert is_consistent(parameters) and triangle_inequality(parameters)
    assert np.allclose(to_log_cholesky(parameters), theta, atol=1e-6)


def test_log_cholesky_of_a_ball_by_hand() -> None:
    """2 kg, I = 0.1: Sigma = 0.05, so U = diag(sqrt 0.05, ., ., sqrt 2), a = log sqrt 2, d = log sqrt 0.025."""
    theta = to_log_cholesky(BALL)
    assert np.allclose(
        theta, [0.5 * np.log(2), *[0.5 * np.log(0.025)] * 3, 0, 0, 0, 0, 0, 0]
    )


def test_jacobian_of_log_cholesky_by_differences() -> None:
    theta, h = np.random.default_rng(1).standard_normal((4, 10)), 1e-6
    steps = h * np.eye(10)
    by_differences = np.stack(
        [
            (from_log_cholesky(theta + s) - from_log_cholesky(theta - s)) / (2 * h)
            for s in steps
        ],
        axis=-1,
    )
    assert np.allclose(
        log_cholesky_jacobian(theta), by_differences, rtol=1e-6, atol=1e-6
    )


@pytest.mark.parametrize(
    ("changed", "value", "triangle"),
    [(0, -2.0, True), (4, 0.5, False), (5, 0.2, False), (1, 1.0, False)],
    ids=[
        "negative mass",
        "a moment above the sum of the others",
        "a product too large",
        "mass centre too far out",
    ],
)
def test_bodies_that_cannot_be(changed: int, value: float, triangle: bool) -> None:
    body = BALL.copy()
    body[changed] = value
    assert not is_consistent(body)
    assert triangle_inequality(body) == triangle


def test_central_inertia_by_the_parallel_axis_theorem() -> None:
    """A ball moved by 0.5 m along x: I_yy and I_zz grow by m 0.25, the central inertia stays."""
    moved = BALL + np.array([0, 1.0, 0, 0, 0, 0, 0.5, 0, 0, 0.5])
    assert np.allclose(central_inertia(moved), 0.1 * np.eye(3))


def test_entropic_divergence_by_hand_and_in_any_frame() -> None:
    """Twice the body: tr(2) = 8, log det = 4 log 2: 8 - 4 log 2 - 4. A change of frame T J T^T leaves it."""
    assert divergence(2 * BALL, BALL) == pytest.approx(4 - 4 * np.log(2))
    assert divergence(BALL, BALL) == pytest.approx(0.0, abs=1e-12)
    assert np.isinf(divergence(np.array([-2.0, *BALL[1:]]), BALL))
    other = from_log_cholesky(0.3 * np.arange(10.0) / 10)
    T = np.eye(4)
    T[:3, 3], T[:2, :2] = [0.3, -0.2, 0.5], [[0.6, -0.8], [0.8, 0.6]]
    turned = [inertial_parameters(T @ pseudo_inertia(x) @ T.T) for x in (other, BALL)]
    assert divergence(*turned) == pytest.approx(divergence(other, BALL))
