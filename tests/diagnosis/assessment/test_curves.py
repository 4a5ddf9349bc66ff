"""Curves of a gap over one variable: hat functions, knots and smoothness."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.diagnosis.assessment.curves import Variable, curve_of

SPREAD = Variable("velocity", "rad/s", np.linspace(-1.0, 1.0, 400) ** 3)


def test_hats_interpolate_and_add_up_to_one() -> None:
    hats = SPREAD.hats()
    np.testing.assert_allclose(hats.sum(axis=1), 1.0)
    np.testing.assert_allclose(hats @ SPREAD.knots, SPREAD.values, atol=1e-12)


def test_a_straight_gap_gives_a_straight_curve() -> None:
    """Second differences are held small, and those of a line over even knots are zero."""
    even = Variable("load", "N m", np.linspace(0.0, 8.0, 400))
    curve = curve_of(even, 3.0 * even.values + 1.0)
    np.testing.assert_allclose(curve.y, 3.0 * curve.x + 1.0, rtol=1e-4)
    assert (curve.variable, curve.unit) == ("load", "N m")


def test_a_direction_has_three_knots() -> None:
    direction = Variable("direction", "1", np.repeat([-1.0, 1.0], 50))
    curve = curve_of(direction, 0.5 * direction.values)
    assert curve.x.tolist() == [-1.0, 0.0, 1.0]
    assert curve.y == pytest.approx([-0.5, 0.0, 0.5], abs=0.02)


def test_a_variable_that_stands_still_has_a_curve() -> None:
    still = Variable("position", "rad", np.full(30, 2.0))
    assert still.knots.tolist() == [1.0, 3.0]
    assert np.isfinite(curve_of(still, np.ones(30)).y).all()
