"""An oscillation at one frequency: predicted on the other half of its recording, with its amplitude."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.diagnosis.assessment.oscillation import amplitudes, predict_oscillation

T = np.arange(0.0, 20.0, 0.02)
SEGMENT = np.zeros(len(T), dtype=int)
HALF = (T >= 10.0).astype(int)


def test_each_half_is_predicted_from_the_other() -> None:
    gap = 0.5 * np.sin(2 * np.pi * 3.0 * T + 0.7)
    predicted = predict_oscillation(T, gap, SEGMENT, HALF)
    assert np.std(gap - predicted) < 0.2 * np.std(gap)  # frequencies are tried in steps


def test_a_phase_that_jumps_between_the_halves_is_not() -> None:
    gap = np.sin(2 * np.pi * 3.0 * T + np.pi * HALF)
    predicted = predict_oscillation(T, gap, SEGMENT, HALF)
    assert np.std(gap - predicted) > np.std(gap)


def test_a_recording_without_a_rest_is_predicted_as_zero() -> None:
    gap = np.sin(2 * np.pi * 3.0 * T)
    assert not predict_oscillation(T, gap, SEGMENT, SEGMENT).any()


def test_amplitudes_are_root_mean_squares_over_recordings() -> None:
    """3 and 1 on two recordings alike in length: sqrt((9 + 1) / 2)."""
    segment = HALF
    gap = np.where(segment == 0, 3.0, 1.0) * np.sin(2 * np.pi * 3.0 * T)
    (on, off) = amplitudes(T, gap, segment, np.array([3.0, 6.0]))
    assert on == pytest.approx(np.sqrt(5.0), rel=1e-3) and off < 1e-3
