"""The torque gap as the generator measures it: nominal arm against recording, filtered, per joint."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from gapscope.blind_check.generator.rigid import inverse_dynamics

TORQUE_BAND, POSITION_BAND, TRIM = 12.0, 30.0, 0.3
"""Cut-offs of torque and position [Hz], and what is cut off at both ends [s]."""
KNEE = 0.005
"""Speed scale of the nominal arm's smoothed sign [rad/s]."""


def smooth(x: np.ndarray, rate: float, cutoff: float) -> np.ndarray:
    """Zero-phase fourth-order Butterworth over time, cut-off [Hz] at most 0.95 of Nyquist; shape (N, n)."""
    cutoff = min(cutoff, 0.95 * rate / 2)
    sos = butter(4, cutoff, output="sos", fs=rate)
    return sosfiltfilt(sos, x, axis=0, padlen=min(len(x) - 1, int(3 * rate / cutoff)))


def nominal_torque(
    model: Any, sheet: dict[str, np.ndarray], t: np.ndarray, q: np.ndarray
) -> np.ndarray:
    """Torque that the nominal arm needs for a recorded motion [N m], (N, n).

    Args:
        model: MuJoCo model of the nominal arm.
        sheet: armature, coulomb, viscous of the data sheet.
        t: time [s], (N,), evenly spaced.
        q: recorded position [rad], (N, n).
    """
    rate = (len(t) - 1) / (t[-1] - t[0])
    even = np.arange(len(t)) / rate
    spline = make_interp_spline(even, smooth(q, rate, POSITION_BAND), k=5)
    position, speed, acceleration = (
        spline(even),
        spline.derivative(1)(even),
        spline.derivative(2)(even),
    )
    return inverse_dynamics(model, position, speed, acceleration) + (
        sheet["armature"] * acceleration
        + sheet["coulomb"] * np.tanh(speed / KNEE)
        + sheet["viscous"] * speed
    )


def residual(
    torque: np.ndarray, predicted: np.ndarray, rate: float
) -> tuple[np.ndarray, np.ndarray]:
    """What is left of the torque, filtered and trimmed [N m], (M, n), and the scale it is measured by, (n,)."""
    cut = round(TRIM * rate)
    recorded = smooth(torque, rate, TORQUE_BAND)[cut:-cut]
    deviation = recorded.std(axis=0)
    gap = recorded - smooth(predicted, rate, TORQUE_BAND)[cut:-cut]
    return gap, np.maximum(deviation, 0.05 * deviation.max())


def rms(x: np.ndarray) -> np.ndarray:
    """Root mean square over time, (n,)."""
    return np.sqrt((x**2).mean(axis=0))
