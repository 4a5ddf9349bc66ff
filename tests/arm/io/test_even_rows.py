"""Logs of a robot that is slower than its logger, and logs that really halt."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.arm.io.plausibility import (
    even_stamps_of_rows,
)

PERIOD = 1 / 30


def motion(t: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(0.7 * t), 0.5 * np.cos(1.1 * t)], axis=1)


def stamps_of_a_faster_logger(rows: int, ratio: float) -> np.ndarray:
    """Stamps at which a logger first sees each of so many samples, its period ``ratio`` times the robot's."""
    return np.ceil(np.arange(rows) / ratio - 1e-9) * PERIOD


def test_samples_of_a_robot_that_is_slower_than_the_logger_are_even() -> None:
    """Every 50th row was stored twice and dropped: its step is two periods long, and the robot went on by one."""
    stamps = stamps_of_a_faster_logger(400, 0.98)
    assert np.diff(stamps).max() == pytest.approx(2 * PERIOD)
    taken = np.arange(400) * PERIOD / 0.98
    even = even_stamps_of_rows(stamps, motion(taken))
    assert even - even[0] == pytest.approx(taken, abs=0.2 * PERIOD)
    assert np.diff(even) == pytest.approx(PERIOD / 0.98, rel=1e-3)


@pytest.mark.parametrize("what", ["even", "halted", "missing"])
def test_stamps_that_are_right_are_left_as_they_are(what: str) -> None:
    """Even ones, those of a logger that halted for a second, and those of a robot that went on by two periods."""
    taken = np.arange(400) * PERIOD
    if what == "missing":
        taken = np.delete(taken, np.arange(25, 400, 50))
    stamps = taken + 1.0 * (taken > 5.0) * (what == "halted")
    assert even_stamps_of_rows(stamps, motion(taken)) is None
