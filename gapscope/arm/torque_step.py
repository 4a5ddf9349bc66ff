"""Steps in which a torque is recorded: a converter of few bits, or a driver that stores whole units."""

from __future__ import annotations

import numpy as np

from gapscope.arm.recording import Recording

SMALLEST_CHANGES = 0.1
"""The step is the size below which this share of all changes between samples lie [1]."""
WHOLE = 0.05
"""A change is a whole number of steps if it differs from one by less [1]..."""
MOSTLY = 0.9
"""...which this share of all changes are [1]."""
NOTED = 0.01
"""Steps are noted whose rounding, step / sqrt 12, exceeds this share of the torque's deviation [1]."""


def torque_step(tau: np.ndarray) -> np.ndarray:
    """Step of each joint's torque [N m], (n,), of a torque tau (N, n); 0 if it has none."""
    return np.array([_step(series) for series in tau.T])


def step_notes(recording: Recording) -> tuple[str, ...]:
    """A note on the joints whose torque comes in coarse steps."""
    if recording.tau is None:
        return ()
    steps, deviation = torque_step(recording.tau), recording.tau.std(axis=0)
    coarse = np.flatnonzero(steps > NOTED * np.sqrt(12.0) * deviation)
    if not len(coarse):
        return ()
    columns = ", ".join(f"tau{j + 1} {steps[j]:.3g}" for j in coarse)
    return (f"torque recorded in coarse steps, which raise the noise floor: {columns}",)


def _step(series: np.ndarray) -> float:
    changes = np.abs(np.diff(series))
    changes = changes[changes > 0]
    if len(changes) < 2:
        return 0.0
    ratio = changes / np.quantile(changes, SMALLEST_CHANGES)
    whole = np.abs(ratio - np.round(ratio)) < WHOLE
    if whole.mean() < MOSTLY:
        return 0.0
    # over many steps the rounding of the log averages out
    return float(changes[whole].sum() / np.round(ratio[whole]).sum())
