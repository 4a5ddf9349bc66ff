"""An oscillation at one frequency that does not follow the motion, predicted on held-out halves of recordings."""

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

    Each fold is predicted with f from all others, and a and b from the rest of its own recording; 0 if a recording
    has no rest.

    Args:
        t: time of the rows since the start of their recording [s], (M,).
        gap: [N m], (M,).
        segment: recording of each row, (M,).
        fold: what is left out together, (M,).
    """
    durations = [float(np.ptp(t[segment == s])) for s in np.unique(segment)]
    longest = max(durations)
    out = np.zeros(len(gap))
    if longest <= 0:
        return out

    step = 1.0 / (OSCILLATION_GRID * longest)
    frequency = np.arange(LEAST_OSCILLATION, MOST_OSCILLATION, step)
    # The power spectrum of any set of folds follows from the Fourier sums of each.
    sums = {
        f: _fourier(frequency, t[fold == f], gap[fold == f]) for f in np.unique(fold)
    }

    for left_out in sums:
        own = fold == left_out
        recording = segment[own][0]
        rest = (segment == recording) & ~own

        # A phase is known within a recording alone.
        if not rest.any():
            continue
        power = _power_without(left_out, sums, segment, fold)
        strongest = frequency[int(np.argmax(power))]

        waves = _waves(strongest, t[rest])
        amplitude, *_ = np.linalg.lstsq(waves, gap[rest], rcond=None)
        out[own] = _waves(strongest, t[own]) @ amplitude
    return out


def _power_without(
    left_out: int, sums: dict[int, np.ndarray], segment: np.ndarray, fold: np.ndarray
) -> np.ndarray:
    """Power per frequency over all folds but one, (K,); phases count within a recording, not between recordings."""
    power = np.zeros(len(sums[left_out]))
    for s in np.unique(segment):
        kept = (segment == s) & (fold != left_out)
        parts = [sums[f] for f in np.unique(fold[kept])]

        if parts:
            power += np.abs(np.sum(parts, axis=0)) ** 2 / kept.sum()
    return power


def amplitudes(
    t: np.ndarray, gap: np.ndarray, segment: np.ndarray, frequency: np.ndarray
) -> np.ndarray:
    """Amplitude of a gap at some frequencies [N m], root mean square over the recordings, (K,)."""
    power = np.zeros(len(frequency))
    for s in np.unique(segment):
        rows = segment == s
        count = rows.sum()

        fourier = _fourier(frequency, t[rows], gap[rows])
        amplitude = np.abs(2.0 / count * fourier)
        power += count * amplitude**2
    return np.sqrt(power / len(gap))


def _fourier(frequency: np.ndarray, t: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Sum of series(t) exp(-2 pi i f t), (K,); to single precision."""
    # Whole turns are taken off before the precision is.
    turns = np.outer(frequency, t) % 1.0
    angle = (2.0 * np.pi * turns).astype(np.float32)
    values = series.astype(np.float32)

    real = np.cos(angle) @ values
    imaginary = np.sin(angle) @ values
    return np.asarray(real - 1j * imaginary)


def _waves(frequency: float, t: np.ndarray) -> np.ndarray:
    """Sine and cosine, (M, 2)."""
    angle = 2.0 * np.pi * frequency * t
    return np.column_stack([np.sin(angle), np.cos(angle)])
