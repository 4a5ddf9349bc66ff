"""Faults of the stamps that small recordings show, made by hand."""

from __future__ import annotations

import numpy as np

from gapscope.arm.recording import Recording
from gapscope.diagnosis.setup_faults.time_stamps import find_stamps, lost

T = np.arange(3000) / 250


def moving(name: str, clock: float, stamps: np.ndarray = T) -> Recording:
    """Recorded positions and velocities, stamped by a clock that runs at a rate of its own [1]."""
    q = np.column_stack([np.sin(2 * T), np.cos(3 * T)])
    dq = np.column_stack([2 * np.cos(2 * T), -3 * np.sin(3 * T)])
    return Recording(name, clock * stamps, q, dq=dq)


def test_a_rate_off_by_one_per_cent_in_all_recordings_is_named() -> None:
    (found,) = find_stamps([moving("a", 0.99), moving("b", 0.99)])
    assert found.variant == "wrong_rate"
    np.testing.assert_allclose(found.fault.values()["amount"], 0.99, rtol=1e-3)
    for recording in (moving("a", 0.99), moving("b", 0.99)):
        np.testing.assert_allclose(found.repair(recording).t, T, atol=0.01)


def test_one_recording_or_two_that_disagree_show_a_velocity_filter() -> None:
    assert find_stamps([moving("a", 0.99)]) == ()
    assert find_stamps([moving("a", 0.99), moving("b", 1.0)]) == ()


def test_stamps_that_jitter_by_half_a_period_are_those_of_an_even_clock() -> None:
    noise = 0.5 * np.random.default_rng(0).standard_normal(len(T)) / 250
    least = 4e-5 * np.arange(len(T))  # stamps keep their order
    stamps = np.maximum.accumulate(T + noise - least) + least
    recording = moving("a", 1.0, stamps)
    (found,) = find_stamps([recording])
    assert found.variant == "jitter"
    np.testing.assert_allclose(found.repair(recording).t, T, atol=1e-3)


def test_rows_that_were_left_out_on_reading_are_not_lost() -> None:
    kept = (T < 4.0) | (T >= 5.0)
    left_out = moving("a", 1.0).part(kept)
    assert lost(left_out) > 0.08
    note = (
        "rows left out in which a position stands still and then leaps: 249 (8.30%), q1"
    )
    assert lost(left_out.part(slice(None), notes=(note,))) < 0.001
