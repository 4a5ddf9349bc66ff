"""Symptoms of an identification: what its fit says by itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import binary_opening
from scipy.signal import welch

from gapscope.arm.recording import Recording
from gapscope.ident.checks.plausible_samples import AT_LIMIT
from gapscope.ident.model.base_parameters import TINY
from gapscope.ident.model.friction import Choice
from gapscope.model.conditioning import uniform

# Measurements behind the troubleshooting table, each one number per joint.


FLAT = 3
"""Equal samples in a row at a joint's largest torque that count as clipped."""


def spectral(
    recordings: Sequence[Recording], cutoff: float
) -> tuple[np.ndarray, np.ndarray]:
    """RMS of the noise in ddq over that of ddq below a cut-off [Hz], and share of the power of dq beyond it; each (n,).

    The noise density of q is the median one in the upper half of the band; differentiating twice multiplies it by
    (2 pi f)^4. Only power that exceeds it counts beyond the cut-off.
    """
    n = recordings[0].n_joints
    noise, acceleration, lost, speed = (np.zeros(n) for _ in range(4))
    for recording in recordings:
        frequency, density = _position_spectrum(recording)
        floor = np.median(density[frequency > recording.rate / 4], axis=0)
        # d/dt multiplies the density by (2 pi f)^2; the bin width turns it into power
        derivative = (2 * np.pi * frequency[:, None]) ** 2
        velocity_power = derivative * (frequency[1] - frequency[0])
        acceleration_power = velocity_power**2
        inside = frequency <= cutoff
        above_floor = np.where(density > 10 * floor, density - floor, 0.0)
        noise += (acceleration_power * floor)[inside].sum(axis=0)
        acceleration += (acceleration_power * density)[inside].sum(axis=0)
        lost += (velocity_power * above_floor)[~inside].sum(axis=0)
        speed += (velocity_power * density)[inside].sum(axis=0)
    noise_share = np.sqrt(noise / np.maximum(acceleration, TINY))
    return noise_share, lost / np.maximum(speed + lost, TINY)


def _position_spectrum(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and power density of q [rad^2/Hz], shape (F, n)."""
    _, q = uniform(recording.t, recording.q, recording.rate)
    # a motion that does not end where it began would leak over the whole spectrum
    drift = np.linspace(0, 1, len(q))[:, None] * (q[-1] - q[0])
    frequency, density = welch(
        q - drift,
        recording.rate,
        nperseg=min(len(q), int(4 * recording.rate)),
        axis=0,
        detrend="linear",
    )
    return frequency, density


def clipped(recordings: Sequence[Recording], limit: np.ndarray | None) -> np.ndarray:
    """Share of the samples at which a joint's torque is at its limit [1], shape (n,).

    At 99 % of the limit [N m] if the data sheet has one; and in any case if the torque stays exactly at its largest
    or smallest value for several samples.
    """
    torques = [np.asarray(r.tau) for r in recordings if r.tau is not None]
    total = sum(len(tau) for tau in torques)
    n = torques[0].shape[1]
    share = np.zeros(n)
    for j in range(n):
        series = [tau[:, j] for tau in torques]
        highest = max(x.max() for x in series)
        lowest = min(x.min() for x in series)
        for x in series:
            extreme = np.isclose(x, highest) | np.isclose(x, lowest)
            # samples that are part of at least ``FLAT`` in a row
            at_limit = binary_opening(extreme, np.ones(FLAT))
            if limit is not None:
                at_limit |= np.abs(x) >= AT_LIMIT * limit[j]
            share[j] += at_limit.sum() / total
    return share


def near_rest(choice: Choice) -> float:
    """Share by which a Stribeck term lowers the error on held-out stretches [1]."""
    tried = [entry for entry in choice.tried if "direction kept" not in entry[0]]
    stribeck = [error for law, error in tried if "Stribeck" in law]
    without = [error for law, error in tried if "Stribeck" not in law]
    return 1 - min(stribeck) / without[0] if stribeck else 0.0
