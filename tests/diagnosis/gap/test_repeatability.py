"""The arm's own repeatability: what differs when the same motion is made again."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.diagnosis.gap.repeatability import repeatability
from gapscope.model.torque_gap import TorqueGap

RATE, NOISE = 50.0, 0.05
FLOOR = np.array([0.02, 0.02])


def motion(seconds: float, seed: int) -> np.ndarray:
    """Torque of a smooth motion that does not come again [N m], (N, 2)."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1 / RATE)
    frequency, phase = rng.uniform(0.1, 1.0, (2, 6, 1)), rng.uniform(0, 6, (2, 6, 1))
    return np.sin(2 * np.pi * frequency * t + phase).sum(axis=1).T


def gap_of(*stretches: np.ndarray) -> tuple[TorqueGap, list[int]]:
    """A model that is off by a tenth, of an arm that scatters, and the edges of stretches."""
    predicted = np.vstack(stretches)
    noise = np.random.default_rng(0).normal(0.0, NOISE, predicted.shape)
    edges = np.cumsum([0, *(len(x) for x in stretches)])
    return TorqueGap(1.1 * predicted + noise, predicted), edges.tolist()


@pytest.mark.parametrize("other", [RATE, 1.0002 * RATE])
def test_a_motion_made_again_tells_what_does_not_repeat(other: float) -> None:
    whole = motion(20.0, seed=1)
    found = repeatability(*gap_of(whole, whole[100:]), [RATE, other], FLOOR)
    assert found is not None
    assert found.seconds == pytest.approx(18.0)
    # not the tenth by which the model is off
    assert found.rms == pytest.approx([NOISE, NOISE], rel=0.1)


def test_rows_of_another_rate_are_of_other_moments() -> None:
    whole = motion(20.0, seed=1)
    assert repeatability(*gap_of(whole, whole), [RATE, 1.01 * RATE], FLOOR) is None


def test_a_motion_that_goes_round_within_a_recording_counts() -> None:
    once = motion(10.0, seed=2)
    found = repeatability(*gap_of(np.vstack([once, once, once])), [RATE], FLOOR)
    assert found is not None and found.rms == pytest.approx([NOISE, NOISE], rel=0.1)


@pytest.mark.parametrize("second", [motion(20.0, seed=4), 1.1 * motion(20.0, seed=3)])
def test_other_motions_tell_nothing(second: np.ndarray) -> None:
    gap = gap_of(motion(20.0, seed=3), second)
    assert repeatability(*gap, [RATE, RATE], FLOOR) is None
