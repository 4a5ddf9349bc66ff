"""Positions that an encoder or driver kept while the arm moved on: they stand still, and then leap.

Where the arm was meanwhile is unknown: the rows are left out, and leave a gap in time.
"""

from __future__ import annotations

import numpy as np

STUCK_TIME = 0.1
"""A position that stands for less is left as it is [s]: slow updates do that."""
LEAP = 20.0
"""It was stuck if it then leaps by so many of its usual steps [1]."""
LEFT_OUT = "rows left out in which a position stands still and then leaps: "
"""Note on them; their number and share follow."""


def stuck_rows(t: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Rows in which a position is stuck, mask of shape (N,), and notes.

    Args:
        t: time [s], (N,).
        q: positions, any unit, (N, n).
    """
    stuck = np.zeros(len(t), dtype=bool)
    joints = []
    for j, series in enumerate(q.T):
        own = _stuck(t, series)
        stuck |= own
        if own.any():
            joints.append(f"q{j + 1}")
    if not joints:
        return stuck, ()
    note = f"{LEFT_OUT}{stuck.sum()} ({stuck.mean():.2%}), {', '.join(joints)}"
    return stuck, (note,)


def _stuck(t: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Rows in which one joint's position, (N,), is stuck."""
    steps = np.diff(series)
    edges = np.flatnonzero(steps) + 1
    starts, stops = np.r_[0, edges], np.r_[edges, len(series)]
    out = np.zeros(len(series), dtype=bool)
    if not len(edges):
        return out
    usual = np.median(np.abs(steps[edges - 1]))
    leap = np.r_[np.abs(steps[edges - 1]), 0.0]
    long = t[stops - 1] - t[starts] >= STUCK_TIME
    for place in np.flatnonzero(long & (leap > LEAP * usual)):
        # the first of them was measured
        out[starts[place] + 1 : stops[place]] = True
    return out
