"""Parts of the noise floor whose size is known."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.diagnosis.gap.noise_floor import NoiseFloor, sticking_rms, timing_error
from gapscope.diagnosis.thresholds import STICKING_SPEED, TIMING_SKEW


def test_friction_at_rest_lies_anywhere_between_its_bounds() -> None:
    """A uniform value in -3..3 has the RMS sqrt 3."""
    at_rest = sticking_rms(np.array([3.0]), np.zeros((1, 1)))
    assert at_rest[0, 0] == pytest.approx(np.sqrt(3.0))
    sliding = sticking_rms(np.array([3.0]), np.full((1, 1), 20 * STICKING_SPEED))
    assert sliding[0, 0] == pytest.approx(0.0, abs=1e-9)


def test_timing_error_of_a_ramp_is_its_slope_times_the_skew() -> None:
    t = np.linspace(0.0, 1.0, 11)
    ramp = np.column_stack([5.0 * t, np.zeros(11)])
    np.testing.assert_allclose(timing_error(ramp, t), [5.0 * TIMING_SKEW, 0.0])


def test_floor_adds_squares_of_both_parts() -> None:
    floor = NoiseFloor(np.array([3.0]), np.array([[4.0], [4.0]]))
    assert floor.floor == pytest.approx([5.0])
