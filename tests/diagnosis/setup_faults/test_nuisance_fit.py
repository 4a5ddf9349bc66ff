"""The bounded fit of an arm's ordinary values, on problems small enough to solve by hand."""

from __future__ import annotations

import numpy as np

from gapscope.diagnosis.setup_faults.nuisance_fit import bounded_minimum

FREE = np.full(2, -np.inf)


def test_without_bounds_it_solves_the_normal_equations() -> None:
    a = np.array([[2.0, 1.0], [1.0, 3.0]])
    found = bounded_minimum(a, np.array([4.0, 7.0]), FREE)
    np.testing.assert_allclose(found, [1.0, 2.0])


def test_a_value_below_its_bound_is_fixed_there_and_the_other_fitted_again() -> None:
    """With x = 0 fixed, the other equation is 3 y = 3."""
    a = np.array([[2.0, 1.0], [1.0, 3.0]])
    found = bounded_minimum(a, np.array([-4.0, 3.0]), np.array([0.0, -np.inf]))
    np.testing.assert_allclose(found, [0.0, 1.0])


def test_a_bound_that_is_kept_has_no_influence() -> None:
    a = np.eye(2)
    found = bounded_minimum(a, np.array([1.0, 2.0]), np.array([0.0, 1.5]))
    np.testing.assert_allclose(found, [1.0, 2.0])
