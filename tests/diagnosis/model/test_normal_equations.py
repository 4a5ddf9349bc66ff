"""Normal equations with nuisances, on numbers small enough to check by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from gapscope.diagnosis.model.normal_equations import NormalEquations, solve, solve_each

COLUMN = np.array([1.0, 0.0, 1.0])
NUISANCE = np.array([0.0, 1.0, 1.0])
GAP = np.array([2.0, 3.0, 5.0])
"""y = 2 A + 3 N exactly."""


def gram(*columns: np.ndarray) -> np.ndarray:
    x = np.stack(columns, axis=1)
    return x.T @ x


def test_a_free_nuisance_takes_what_is_its_own() -> None:
    normal = NormalEquations(gram(COLUMN, NUISANCE, GAP), 1, np.array([[1e-12]]))
    theta = normal.solve(np.array([0]))
    assert theta == pytest.approx([2.0], abs=1e-6)
    assert normal.nuisance(theta, np.array([0])) == pytest.approx([3.0], abs=1e-6)


def test_a_nuisance_with_a_narrow_prior_stays_zero() -> None:
    """A theta alone: theta = A y / A A = 7 / 2."""
    normal = NormalEquations(gram(COLUMN, NUISANCE, GAP), 1, np.array([[1e12]]))
    theta = normal.solve(np.array([0]))
    assert theta == pytest.approx([3.5], abs=1e-6)
    assert normal.nuisance(theta, np.array([0])) == pytest.approx([0.0], abs=1e-6)


def test_a_prior_of_the_size_of_the_data_shrinks_a_nuisance() -> None:
    """Without the term delta = N y / (N N + Q) = 8 / (2 + 4)."""
    normal = NormalEquations(gram(COLUMN, NUISANCE, GAP), 1, np.array([[4.0]]))
    none = np.array([], dtype=int)
    assert normal.solve(none) == pytest.approx([0.0])
    assert normal.nuisance(np.zeros(1), none) == pytest.approx([8 / 6])


def test_the_rest_is_measured_with_the_nuisance_or_without() -> None:
    total = gram(COLUMN, NUISANCE, GAP)
    normal, places = NormalEquations(total, 1, np.array([[1e-12]])), np.array([0])
    theta = normal.solve(places)
    rows = gram(COLUMN, NUISANCE, GAP, np.zeros_like(GAP))[None]
    with_nuisance = normal.rest(rows, theta, places, corrected=True)
    without = normal.rest(rows, theta, places, corrected=False)
    assert with_nuisance == pytest.approx([0.0], abs=1e-6)
    assert without == pytest.approx([18.0], abs=1e-4)  # |3 N|^2


def test_a_column_of_rounding_gets_zero_and_the_others_their_values() -> None:
    """The centre of a load along parallel axes: what rounding leaves of its column says nothing of any value."""
    rounding = 1e-8 * np.array([1.0, -2.0, 1.5])
    total = gram(COLUMN, rounding, NUISANCE, GAP)
    normal = NormalEquations(total, 2, np.array([[1e-12]]))
    assert normal.solve(np.array([0, 1])) == pytest.approx([2.0, 0.0], abs=1e-6)


def test_a_value_below_its_bound_stays_there_and_the_other_is_fitted_again() -> None:
    """|x + y - 1|^2 + |y - 3|^2 with x >= -1: by hand x = -2, y = 3 without the bound; with x = -1, y = 2.5."""
    columns = np.array([[1.0, 1.0, 1.0], [0.0, 1.0, 3.0]])
    least = columns.T @ columns
    places = np.array([0, 1])
    np.testing.assert_allclose(solve(least, places), [-2.0, 3.0], rtol=1e-6)
    bounds = np.array([-1.0, -np.inf])
    np.testing.assert_allclose(solve(least, places, bounds), [-1.0, 2.5], rtol=1e-6)


def test_many_sets_at_once_are_each_fitted_within_their_bounds() -> None:
    """Against scipy's solver of bounded least squares, on sets of which most meet a bound."""
    rng = np.random.default_rng(1)
    x = rng.normal(size=(2, 40, 7))
    least = np.swapaxes(x, 1, 2) @ x
    bounds = rng.uniform(-0.1, 0.1, 6)
    sets = np.array([[0, 1, 2], [1, 3, 5], [0, 2, 4], [3, 4, 5]])
    found = solve_each(least, sets, bounds)
    for fold, own in enumerate(found):
        for columns, values in zip(sets, own, strict=True):
            lowest = (bounds[columns], np.inf)
            exact = lsq_linear(x[fold][:, columns], x[fold][:, -1], lowest)
            np.testing.assert_allclose(values[columns], exact.x, atol=1e-6)
            np.testing.assert_array_equal(
                values[columns], solve(least[fold], columns, bounds)[columns]
            )


def test_nuisances_of_very_different_size_are_eliminated() -> None:
    """Columns 10^9 apart in size: their normal equations are singular to rounding unless they are scaled."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(30, 4)) * np.array([1.0, 1e9, 1e-9, 1.0])
    normal = NormalEquations(x.T @ x, 1, np.diag([1e-12, 1e-12]))
    theta = normal.solve(np.array([0]))
    direct = np.linalg.lstsq(x[:, :2] / [1.0, 1e9], x[:, 3], rcond=None)[0]
    np.testing.assert_allclose(theta, direct[:1], rtol=1e-5)
