"""Clocks of recordings, with stamps made by hand."""

from __future__ import annotations

import numpy as np

from gapscope.diagnosis.setup_faults.clock import (
    even_stamps,
    sample_count,
    stamps_are_wrong,
    unevenness,
)

EVEN = 0.01 * np.arange(100)


def test_an_even_clock_is_even() -> None:
    np.testing.assert_array_equal(sample_count(EVEN), np.arange(100))
    np.testing.assert_allclose(unevenness(EVEN), 0.0, atol=1e-9)
    np.testing.assert_allclose(even_stamps(EVEN), EVEN, atol=1e-12)


def test_a_gap_skips_sample_numbers() -> None:
    t = np.concatenate([EVEN[:50], EVEN[60:]])
    np.testing.assert_array_equal(np.diff(sample_count(t))[48:51], [1, 11, 1])


def test_jittered_stamps_of_a_smooth_motion_are_wrong() -> None:
    jitter = 2e-3 * np.random.default_rng(0).standard_normal(100)
    q = np.sin(5 * EVEN)[:, None]
    assert stamps_are_wrong(EVEN + jitter, q)
    sampled_late = np.sin(5 * (EVEN + jitter))[:, None]
    assert not stamps_are_wrong(EVEN + jitter, sampled_late)
