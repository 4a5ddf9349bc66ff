"""Set points of a reference that was recorded at a lower rate than the rest, and the smooth motion through them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_interp_spline

from gapscope.arm.recording import Recording

SET_POINT_LEAST = (
    30  # Set points of a reference at least, for their distance to be regular. (hand)
)
SET_POINT_REGULARITY = (
    0.8  # Share of their distances that are alike within a row, at least [1]. (hand)
)
# A row is the corner of a line if the second difference there exceeds this share of that at the plainest [1]. (hand)
CORNER_SHARE = 0.02


@dataclass(frozen=True)
class SetPoints:
    """Set points of a recording.

    Attributes:
        variant: ``held`` until the next one, or ``interpolated`` between two by a straight line.
        rows: at which they are.
        every: rows from one to the next, median.
    """

    variant: str
    rows: np.ndarray
    every: int

    def smooth(self, recording: Recording) -> Recording:
        """The recording with the cubic spline through the set points as its reference."""
        assert recording.q_ref is not None
        rows = _with_rests(self.rows, self.every, len(recording.t))
        t = recording.t
        spline = make_interp_spline(t[rows], recording.q_ref[rows], k=3)
        rate = None if recording.dq_ref is None else spline(t, 1)
        return replace(recording, q_ref=spline(t), dq_ref=rate)


def set_points(recording: Recording) -> SetPoints | None:
    """Set points of a recording's reference; ``None`` if it changes from row to row, or at no regular steps."""
    if recording.q_ref is None or len(recording.t) < SET_POINT_LEAST:
        return None
    step = np.diff(recording.q_ref, axis=0)
    changed = np.flatnonzero(step.any(axis=1)) + 1
    if _every(changed) is not None and not _quantised(step):
        return _regular("held", changed)
    # a straight line has no second difference but for rounding, its corners have
    bend = np.abs(np.diff(step, axis=0)) / np.maximum(
        np.ptp(recording.q_ref, axis=0), 1e-9
    )
    most = bend.max(axis=1)
    plain = np.sort(most)[-SET_POINT_LEAST]
    corners = np.flatnonzero(most > CORNER_SHARE * plain) + 1
    return _regular("interpolated", corners)


def _regular(variant: str, rows: np.ndarray) -> SetPoints | None:
    every = _every(rows)
    return None if every is None else SetPoints(variant, rows, every)


def _every(rows: np.ndarray) -> int | None:
    """Median distance of rows if it is two or more, and most distances are it or one less or more; rests aside."""
    distance = np.diff(rows)
    if len(distance) < SET_POINT_LEAST:
        return None
    every = int(np.median(distance))
    moving = distance[distance < 4 * every]
    near = np.abs(moving - every) <= 1
    # of two rows, one more or less would be anything
    regular = near & (moving > 1)
    if every < 2 or regular.mean() < SET_POINT_REGULARITY:
        return None
    return every


def _quantised(step: np.ndarray) -> bool:
    """Whether all joints step by whole multiples of few sizes: an encoder's or a log's resolution, not a rate."""
    for column in step.T:
        sizes = np.abs(column[column != 0])
        if len(np.unique(np.round(sizes / max(sizes.max(initial=0.0), 1e-12), 4))) > 10:
            return False
    return True


def _with_rests(rows: np.ndarray, every: int, count: int) -> np.ndarray:
    """Set points, with further ones at the same distance where the reference rests, and the first and last row."""
    edges = np.unique(np.concatenate([[0], rows, [count - 1]]))
    filled = [
        np.arange(first, last, every) if last - first > 2 * every else [first]
        for first, last in itertools.pairwise(edges)
    ]
    return np.concatenate([*filled, edges[-1:]])
