"""Bases of columns: what is rounding has no direction."""

from __future__ import annotations

import numpy as np

from gapscope.ident.model.rank import orthonormal_columns


def test_a_column_of_rounding_is_no_direction() -> None:
    """A body that does not act on a joint leaves 1e-17 there, which changes with the last digit of every input."""
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(50, 3)) @ np.diag([1.0, 1e-3, 1e4])
    rounding = 1e-15 * rng.normal(size=(50, 1))
    basis = orthonormal_columns(np.hstack([columns, rounding]), 1e-3)
    assert basis.shape == (50, 3)
    np.testing.assert_allclose(basis.T @ basis, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(basis @ (basis.T @ columns), columns, rtol=1e-9)
    assert orthonormal_columns(columns[:, [0, 0, 1]], 1e-3).shape == (50, 2)
