"""Whose derivative a recorded velocity is: the arm's position or the reference."""

from __future__ import annotations

import numpy as np

from gapscope.arm.reading import references
from gapscope.arm.recording import Recording
from gapscope.diagnosis.thresholds import (
    LEAST_MOTION_SHARE,
    RATE_BAND,
    REFERENCE_VELOCITY_RATIO,
)
from gapscope.model.conditioning import low_pass


def is_of_reference(recording: Recording) -> bool:
    """Whether the recorded velocity is decidedly nearer to the reference's than to that of the positions.

    Below ``RATE_BAND``, on both halves, and on each joint that moves; up to a factor, which may be a wrong rate's or
    unit's. An arm led by hand, whose reference follows the position, has no such joint.
    """
    if recording.dq is None or recording.q_ref is None or len(recording.t) < 50:
        return False
    q_ref, dq_ref = references(recording, "dq")
    rate = recording.rate
    cutoff = min(RATE_BAND, 0.2 * rate)
    by_position = np.gradient(recording.q, recording.t, axis=0)
    series = (recording.dq, dq_ref, by_position)
    dq, planned, derived = (low_pass(x, rate, cutoff) for x in series)
    moves = np.ptp(q_ref, axis=0) > LEAST_MOTION_SHARE * np.ptp(q_ref, axis=0).max()
    half = len(dq) // 2
    for rows in (slice(None, half), slice(half, None)):
        from_planned = _unlike(dq[rows], planned[rows])[moves]
        from_derived = _unlike(dq[rows], derived[rows])[moves]
        if not (from_planned < REFERENCE_VELOCITY_RATIO * from_derived).all():
            return False
    return bool(moves.any())


def _unlike(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """RMS of what x leaves of the multiple of y nearest to it, of each column, (n,)."""
    factor = (x * y).sum(axis=0) / np.maximum((y**2).sum(axis=0), 1e-12)
    return np.sqrt(((x - factor * y) ** 2).mean(axis=0))
