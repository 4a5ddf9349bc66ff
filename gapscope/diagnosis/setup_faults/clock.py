"""The clock of a recording: how even its stamps are, and whether the samples are as uneven as the stamps say."""

from __future__ import annotations

import numpy as np

from gapscope.arm.io.even_rows import roughness
from gapscope.diagnosis.thresholds import (
    CLOCK_WANDER_SAMPLES,
    EVEN_CLOCK_RATIO,
    LOST_SAMPLE_STEP,
)


def sample_count(t: np.ndarray) -> np.ndarray:
    """Number of each sample on an even clock, from 0, (N,); steps beyond ``LOST_SAMPLE_STEP`` periods skip numbers.

    Shorter steps are taken as one period, or rounded to two if that leaves less unevenness: a jittered step may be
    nearly two periods long, a dropped row leaves a step of two. Of a clock that jitters by half a period even longer
    steps are single ones: all steps are, if that leaves least.
    """
    periods = np.diff(t) / np.median(np.diff(t))
    rounded = np.maximum(np.round(periods), 1.0)
    single = np.where(periods > LOST_SAMPLE_STEP, rounded, 1.0)
    choices = (single, rounded, np.ones_like(periods))
    counts = [np.concatenate([[0.0], np.cumsum(steps)]) for steps in choices]
    return min(counts, key=lambda count: float(np.std(_wander_free(t, count))))


def unevenness(t: np.ndarray) -> np.ndarray:
    """Stamps less an even clock's, without slow wander, in periods, (N,)."""
    return _wander_free(t, sample_count(t))


def even_stamps(t: np.ndarray) -> np.ndarray:
    """Stamps of an even clock nearest to t [s], (N,): the line through stamps against sample numbers."""
    count = sample_count(t)
    slope, start = np.polyfit(count, t, 1)
    return start + slope * count


def stamps_are_wrong(t: np.ndarray, q: np.ndarray) -> bool:
    """Whether the motion is smoother over an even clock than over the stamps, decidedly; q [rad], (N, n).

    Each sample is compared with the line through its neighbours. Samples taken at even times and stamped unevenly
    leave the line by speed times the error of the stamp; samples really taken unevenly do so over an even clock.
    """
    over_stamps = roughness(t, q)
    over_even_clock = roughness(sample_count(t), q)
    return bool(over_even_clock < EVEN_CLOCK_RATIO * over_stamps)


def _wander_free(t: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Stamps less the line through them and less their moving mean, in periods, (N,)."""
    slope, start = np.polyfit(count, t, 1)
    error = (t - start - slope * count) / slope
    kernel = np.ones(min(CLOCK_WANDER_SAMPLES, len(error)))
    inside = np.convolve(np.ones(len(error)), kernel, "same")
    return error - np.convolve(error, kernel, "same") / inside
