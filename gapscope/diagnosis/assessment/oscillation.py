"""A line in frequency: an oscillation that does not follow the motion, predicted from one half of a recording."""

from __future__ import annotations

import numpy as np

from gapscope.diagnosis.thresholds import (
    LEAST_OSCILLATION,
    MOST_OSCILLATION,
    OSCILLATION_GRID,
)


def predict_oscillation(
    t: np.ndarray, gap: np.ndarray, segment: np.ndarray, fold: np.ndarray
) -> np.ndarray:
    """Prediction of a gap [N m], (M,), as a sin(2 pi f t) + b cos(2 pi f t), a and b per recording, f common.

    Each fold is predicted with f from all others, and a and b from the rest of its own recording; 0 where a recording
    has no rest.

    Args:
        t: time of the rows since the start of their recording [s], (M,).
        gap: [N m], (M,).
        segment: recording of each row, (M,).
        fold: what is left out together, (M,).
    """
    spans = {s: float(np.ptp(t[segment == s])) for s in np.unique(segment)}
    out = np.zeros(len(gap))
    if max(spans.values()) <= 0:
        return out
    frequency = np.arange(
        LEAST_OSCILLATION,
        MOST_OSCILLATION,
        1.0 / (OSCILLATION_GRID * max(spans.values())),
    )
    # Fourier sums of every fold: powers of any set of folds follow
    sums = {
        f: _fourier(frequency, t[fold == f], gap[fold == f]) for f in np.unique(fold)
    }
    of = {f: segment[fold == f][0] for f in sums}
    for f in sums:
        power = np.zeros(len(frequency))
        for s in spans:
            rest = [sums[g] for g in sums if of[g] == s and g != f]
            rows = ((segment == s) & (fold != f)).sum()
            power += np.abs(np.sum(rest, axis=0)) ** 2 / max(rows, 1) if rest else 0.0
        best = frequency[int(np.argmax(power))]
        own = fold == f
        rest = (segment == of[f]) & ~own
        if rest.any():
            a = _waves(best, t[rest])
            out[own] = (
                _waves(best, t[own]) @ np.linalg.lstsq(a, gap[rest], rcond=None)[0]
            )
    return out


def amplitudes(
    t: np.ndarray, gap: np.ndarray, segment: np.ndarray, frequency: np.ndarray
) -> np.ndarray:
    """Amplitude of a gap at some frequencies [N m], root mean square over the recordings, (K,)."""
    power = np.zeros(len(frequency))
    for s in np.unique(segment):
        rows = segment == s
        power += (
            rows.sum()
            * np.abs(2.0 / rows.sum() * _fourier(frequency, t[rows], gap[rows])) ** 2
        )
    return np.sqrt(power / len(gap))


def _fourier(frequency: np.ndarray, t: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Sum of series(t) exp(-2 pi i f t), (K,); to single precision."""
    angle = (2.0 * np.pi * (np.outer(frequency, t) % 1.0)).astype(np.float32)
    small = series.astype(np.float32)
    return np.asarray(np.cos(angle) @ small - 1j * (np.sin(angle) @ small))


def _waves(frequency: float, t: np.ndarray) -> np.ndarray:
    """Sine and cosine, (M, 2)."""
    angle = 2.0 * np.pi * frequency * t
    return np.column_stack([np.sin(angle), np.cos(angle)])
