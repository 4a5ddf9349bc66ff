"""A reference at another pace than the arm: q(t) = q_ref(t0 + s (t - t0) - d), with a constant s and a lag d."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.optimize import least_squares

from gapscope.arm.recording import Recording
from gapscope.diagnosis.thresholds import (
    NAMED_RATE_ERROR,
    PACE_FIT_SHARE,
    PACE_GAIN,
    PACE_LAGS,
    PACE_MISFIT,
    PACE_SAMPLES,
    PACE_STARTS,
    PACE_TRACKED,
)


def pace(recording: Recording) -> float | None:
    """s of a recording [1]; ``None`` if its reference and the arm go at one pace, or at none that is constant.

    Fitted to the first part of the recording, judged on the rest.
    """
    if recording.q_ref is None:
        return None
    rows = np.linspace(0, len(recording.t) - 1, PACE_SAMPLES).astype(int)
    t, q = recording.t[rows] - recording.t[0], recording.q[rows]
    scale = np.maximum(np.ptp(q, axis=0), 1e-9)
    moving = scale > 0.1 * scale.max()
    planned = (recording.t - recording.t[0], recording.q_ref[:, moving])
    q, scale = q[:, moving], scale[moving]

    def error(x: np.ndarray) -> np.ndarray:
        """Positions less the reference at a pace and lag, over their ranges, with the mean error of each joint out."""
        at = x[0] * t - x[1]
        there = np.column_stack([np.interp(at, planned[0], c) for c in planned[1].T])
        difference = (q - there) / scale
        return np.asarray(difference - difference[fitted].mean(axis=0))

    fitted = t <= PACE_FIT_SHARE * t[-1]
    same = min((np.array([1.0, d]) for d in PACE_LAGS), key=lambda x: _rms(error(x)))
    if _rms(error(same)[~fitted]) < PACE_TRACKED:
        return None
    starts = (np.array(x) for x in itertools.product(PACE_STARTS, PACE_LAGS))
    best = min(starts, key=lambda x: _rms(error(x)[fitted]))
    found = least_squares(
        lambda x: error(x)[fitted].ravel(), best, x_scale=(0.01, 0.01)
    ).x
    # what was not fitted decides; beyond the end of the reference there is nothing to compare
    judged = ~fitted & (found[0] * t <= planned[0][-1])
    if (
        judged.sum() < 0.1 * len(t)
        or abs(np.log(max(found[0], 1e-9))) < NAMED_RATE_ERROR
    ):
        return None
    left = _rms(error(found)[judged])
    if left > PACE_MISFIT or left * PACE_GAIN > _rms(error(same)[judged]):
        return None
    return float(found[0])


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))
