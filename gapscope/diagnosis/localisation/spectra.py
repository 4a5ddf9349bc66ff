"""How a gap follows the joint's own signals: coherence, and gain and phase of the transfer function [bendat2010]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import csd, welch

from gapscope.diagnosis.localisation.stacked_rows import MotionRows
from gapscope.model.conditioning import TORQUE_CUTOFF

STRETCH = 2.0
"""Length of the stretches over which spectra are averaged [s]."""
STEP = 0.25
"""Grid of frequencies on which recordings of different length are averaged [Hz]."""
CHANCE = 0.01
"""Probability with which signals without relation reach the coherence of ``Spectra.chance`` [1]."""
LEAST_SIZE = 16
"""Segments with fewer samples have no spectrum."""
TINY = 1e-300
"""Keeps a quotient of powers finite."""


@dataclass(frozen=True)
class Drive:
    """A signal that a gap may follow: name and unit of gap over signal."""

    name: str
    unit: str


DRIVES = (
    Drive("torque", "N m per N m"),
    Drive("velocity", "N m s/rad"),
    Drive("acceleration", "N m s²/rad"),
)
"""The joint's own nominal torque, velocity and acceleration."""


@dataclass(frozen=True)
class Spectra:
    """Spectra of one joint's gap e and of K signals x, averaged over stretches of all recordings; F frequencies.

    Attributes:
        frequency: [Hz], (F,).
        gap: power density S_ee [(N m)^2/Hz], (F,).
        signals: S_xx, in the squared unit of the signal per Hz, (K, F).
        cross: S_xe, complex, (K, F).
        averages: number of stretches that count, half of overlapping ones being new [1].
    """

    frequency: np.ndarray
    gap: np.ndarray
    signals: np.ndarray
    cross: np.ndarray
    averages: float

    @property
    def coherence(self) -> np.ndarray:
        """gamma^2 = |S_xe|^2 / (S_xx S_ee), the share of the gap's power that follows each signal, (K, F)."""
        return np.abs(self.cross) ** 2 / np.maximum(self.signals * self.gap, TINY)

    def chance(self, lines: int) -> float:
        """Coherence that signals without relation exceed with probability ``CHANCE``, over a band of so many lines.

        Of N independent averages the coherence exceeds c with probability (1 - c)^(N - 1) [bendat2010].
        """
        independent_lines = max(lines * STEP * STRETCH / 1.5, 1.0)
        freedom = max(self.averages * independent_lines - 1, 1.0)
        return float(1 - CHANCE ** (1 / freedom))

    def band(self, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coherence, (K,), and transfer function S_xe / S_xx, complex, (K,), over a band of frequencies."""
        cross = self.cross[:, mask].sum(axis=1)
        signals = self.signals[:, mask].sum(axis=1)
        gap = self.gap[mask].sum()
        coherence = np.abs(cross) ** 2 / np.maximum(signals * gap, TINY)
        return coherence, cross / np.maximum(signals, TINY)


def spectra(
    error: np.ndarray, rows: MotionRows, load: np.ndarray, joint: int
) -> Spectra:
    """Spectra of one joint's gap [N m], (M,), and of ``DRIVES``; load is the nominal torque [N m], (M, n)."""
    j = joint - 1
    signals = (load[:, j], rows.dq[:, j], rows.ddq[:, j])
    frequency = np.arange(0.0, TORQUE_CUTOFF + STEP / 2, STEP)
    gap = np.zeros(len(frequency))
    own = np.zeros((len(signals), len(frequency)))
    cross = np.zeros(own.shape, dtype=complex)
    averages, total = 0.0, 0
    for segment, rate in enumerate(rows.rates):
        inside = rows.segment == segment
        count = int(inside.sum())
        size = min(count, int(STRETCH * rate))
        if size < LEAST_SIZE:
            continue
        # a segment weighs as many samples as it has
        grid, power = welch(error[inside], rate, nperseg=size)
        gap += count * np.interp(frequency, grid, power)
        for k, signal in enumerate(signals):
            _, power = welch(signal[inside], rate, nperseg=size)
            own[k] += count * np.interp(frequency, grid, power)
            _, density = csd(signal[inside], error[inside], rate, nperseg=size)
            cross[k] += count * np.interp(frequency, grid, density)
        averages += count / size
        total += count
    total = max(total, 1)
    return Spectra(frequency, gap / total, own / total, cross / total, averages)
