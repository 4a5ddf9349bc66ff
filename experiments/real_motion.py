"""Motion of a recording by filters of its own, for what is put into it; not the conditioning of the diagnosis."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.signal import butter, sosfiltfilt

from gapscope.arm.motions.motion import Motion
from gapscope.arm.recording import Recording

BAND = 15.0
"""Positions are followed up to this frequency [Hz], or 0.35 of the sampling rate if that is lower."""


def filtered(series: np.ndarray, rate: float, cutoff: float) -> np.ndarray:
    """Zero-phase Butterworth low-pass of order 2, forward and backward, along axis 0."""
    sos = butter(2, min(cutoff, 0.35 * rate), output="sos", fs=rate)
    padding = min(len(series) - 1, int(3 * rate / cutoff))
    return np.asarray(sosfiltfilt(sos, series, axis=0, padlen=padding))


def uniform_grid(t: np.ndarray) -> np.ndarray:
    """As many uniform times as t has, from its first to its last [s]."""
    return np.linspace(t[0], t[-1], len(t))


def smooth_motion(recording: Recording) -> Motion:
    """Filtered positions on a uniform grid with central differences; time from the recording's start."""
    grid = uniform_grid(recording.t)
    rate = (len(grid) - 1) / (grid[-1] - grid[0])
    q = PchipInterpolator(recording.t, recording.q)(grid)
    q = filtered(q, rate, BAND)
    dq = np.gradient(q, grid, axis=0, edge_order=2)
    ddq = filtered(np.gradient(dq, grid, axis=0, edge_order=2), rate, BAND)
    return Motion(grid, q, dq, ddq)


def at_samples(series: np.ndarray, motion: Motion, t: np.ndarray) -> np.ndarray:
    """A series on a motion's grid, (N, n), at times t [s], (M, n)."""
    return np.asarray(
        PchipInterpolator(motion.t, series)(np.clip(t, *motion.t[[0, -1]]))
    )
