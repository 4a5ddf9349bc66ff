"""How well a recording's torque was measured: where it was not, and in which steps."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d

from gapscope.arm.recording import Recording, held_torque, torque_step

FILTER_REACH = 0.04
"""A torque that was not measured spoils those so near to it [s]: the 12 Hz filter's response is half as wide."""


def unknown_torque(
    recording: Recording, span: slice, grid: np.ndarray
) -> np.ndarray | None:
    """Which torques of a piece were not measured, or are mixed with such by filters; ``None`` if all were.

    Args:
        recording: the recording.
        span: rows of the piece.
        grid: times at which it is asked [s], (M,).

    Returns:
        A mask (M, n).
    """
    if recording.tau is None:
        return None
    t = recording.t[span]
    held = held_torque(t, recording.q[span], recording.tau[span]).unknown
    if not held.any():
        return None
    near = int(np.ceil(FILTER_REACH * recording.rate))
    widened = maximum_filter1d(held.astype(np.uint8), 2 * near + 1, axis=0)
    places = np.clip(np.searchsorted(t, grid), 0, len(t) - 1)
    return np.asarray(widened[places] > 0)


def torque_steps(recording: Recording) -> np.ndarray | None:
    """Steps in which a recording's torque comes [N m], (n,), 0 for none; ``None`` if no joint's has any."""
    if recording.tau is None:
        return None
    steps = torque_step(recording.tau)
    return steps if steps.any() else None
