"""Rows of a log that were taken evenly though their stamps are not.

A logger that runs faster than the robot stores a measurement twice now and then, and stamps by its own clock. With the
repeated rows dropped, their stamps leave a step of two periods in which the robot has moved on by one.
"""

from __future__ import annotations

import numpy as np

EVEN_RATIO = 0.5
"""Rows are evenly taken if the motion over them is rougher than over the stamps by less than this factor [1]."""
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
