"""The clock of a recording: how even its stamps are, and whether its rows were taken evenly though stamped unevenly.

A logger that runs faster than the robot stores a measurement twice now and then, and stamps by its own clock. With the
repeated rows dropped, their stamps leave a step of two periods in which the robot has moved on by one.
"""

from __future__ import annotations

import numpy as np

EVEN_RATIO = 0.5
"""Rows are evenly taken if the motion over them is rougher than over the stamps by less than this factor [1]."""
LOST_SAMPLE_STEP = (
    2.5  # A step longer than this many periods has lost samples in it [1]. (hand)
)
CLOCK_WANDER_SAMPLES = (
    25  # Samples over which the slow wander of a clock is taken out. (hand)
)
LONGEST_STEP = 2.5
"""With a step longer than this many periods samples are lost as well, and the stamps are left as they are."""

EVENLY_TAKEN = "rows stamped evenly: by their stamps the motion halts wherever a repeated row was dropped"
"""Note of a recording whose rows were stamped anew."""


def roughness(x: np.ndarray, q: np.ndarray) -> float:
    """Squared distance of samples q [rad], (N, n), from the line through their neighbours over x, (N,), summed [1].

    Relative to each joint's range. Samples that were taken at even times and stamped unevenly leave the line over the
    stamps by speed times the error of the stamp; samples really taken unevenly do so over an even clock.
    """
    before, middle, after = x[:-2], x[1:-1], x[2:]
    share = (middle - before) / (after - before)
    step = q[2:] - q[:-2]
    on_line = q[:-2] + share[:, None] * step
    distance = q[1:-1] - on_line
    # a joint that hardly moves would show its quantisation
    travel = np.ptp(q, axis=0)
    moving = travel > 1e-2 * max(float(travel.max()), 1e-9)
    relative = distance[:, moving] / travel[moving]
    return float((relative**2).sum())


def even_stamps_of_rows(t: np.ndarray, q: np.ndarray) -> np.ndarray | None:
    """Stamps of rows that were taken evenly [s], (N,): the line through t; ``None`` if the stamps are right.

    Args:
        t: stamps of the rows that are left once repeated ones are dropped [s], (N,).
        q: positions [rad], (N, n).
    """
    steps = np.diff(t)
    if len(t) < 4 or steps.max() > LONGEST_STEP * np.median(steps):
        return None
    rows = np.arange(len(t), dtype=float)
    if roughness(rows, q) >= EVEN_RATIO * roughness(t, q):
        return None
    slope, start = np.polyfit(rows, t, 1)
    return np.asarray(start + slope * rows)


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
    return bool(over_even_clock < EVEN_RATIO * over_stamps)


def _wander_free(t: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Stamps less the line through them and less their moving mean, in periods, (N,)."""
    slope, start = np.polyfit(count, t, 1)
    error = (t - start - slope * count) / slope
    kernel = np.ones(min(CLOCK_WANDER_SAMPLES, len(error)))
    inside = np.convolve(np.ones(len(error)), kernel, "same")
    return error - np.convolve(error, kernel, "same") / inside
