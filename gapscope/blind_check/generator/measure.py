"""The torque gap as the generator measures it: nominal arm against recording, filtered, per joint."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from gapscope.blind_check.generator.rigid import inverse_dynamics

TORQUE_BAND = 12.0
"""Cut-off of the torque [Hz]."""
POSITION_BAND = 30.0
"""Cut-off of the position [Hz]."""
TRIM = 0.3
"""Time that is left out at both ends [s]."""
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
    position = spline(even)
    speed = spline.derivative(1)(even)
    acceleration = spline.derivative(2)(even)
    rigid = inverse_dynamics(model, position, speed, acceleration)
    return rigid + sheet_torque(sheet, speed, acceleration)


def sheet_torque(
    sheet: dict[str, np.ndarray], speed: np.ndarray, acceleration: np.ndarray
) -> np.ndarray:
    """Torque of rotors and friction by the data sheet [N m], (N, n)."""
    rotors = sheet["armature"] * acceleration
    dry = sheet["coulomb"] * np.tanh(speed / KNEE)
    return rotors + dry + sheet["viscous"] * speed


def residual(
    torque: np.ndarray, predicted: np.ndarray, rate: float
) -> tuple[np.ndarray, np.ndarray]:
    """Recorded minus predicted torque, filtered and trimmed [N m], (M, n), and the scale it is measured by, (n,)."""
    cut = round(TRIM * rate)
    recorded = smooth(torque, rate, TORQUE_BAND)[cut:-cut]
    needed = smooth(predicted, rate, TORQUE_BAND)[cut:-cut]
    deviation = recorded.std(axis=0)
    # a joint that hardly moves is measured by a share of the busiest one
    scale = np.maximum(deviation, 0.05 * deviation.max())
    return recorded - needed, scale


def rms(x: np.ndarray) -> np.ndarray:
    """Root mean square over time, (n,)."""
    return np.sqrt((x**2).mean(axis=0))
