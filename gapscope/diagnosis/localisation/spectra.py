"""How a gap follows the joint's own signals: coherence, and gain and phase of the transfer function [bendat2010]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import csd, welch

from gapscope.diagnosis.localisation.stacked_rows import Rows
from gapscope.ident.signals.conditioning import TORQUE_CUTOFF

STRETCH = 2.0
"""Length of the stretches over which spectra are averaged [s]."""
STEP = 0.25
"""Grid of frequencies on which recordings of different length are averaged [Hz]."""


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
        return np.abs(self.cross) ** 2 / np.maximum(self.signals * self.gap, 1e-300)

    def chance(self, lines: int) -> float:
        """Coherence that signals without relation exceed with 1 %, over a band of so many lines."""
        return float(
            1
            - 0.01
            ** (
                1 / max(self.averages * max(lines * STEP * STRETCH / 1.5, 1.0) - 1, 1.0)
            )
        )

    def band(self, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coherence, (K,), and transfer function S_xe / S_xx, complex, (K,), over a band of frequencies."""
        cross, signals, gap = (
            self.cross[:, mask].sum(axis=1),
            self.signals[:, mask].sum(axis=1),
            self.gap[mask].sum(),
        )
        return np.abs(cross) ** 2 / np.maximum(
            signals * gap, 1e-300
        ), cross / np.maximum(signals, 1e-300)


def spectra(error: np.ndarray, rows: Rows, load: np.ndarray, joint: int) -> Spectra:
    """Spectra of one joint's gap [N m], (M,), and of ``DRIVES``; load is the nominal torque [N m], (M, n)."""
    j = joint - 1
    signals = (load[:, j], rows.dq[:, j], rows.ddq[:, j])
    frequency = np.arange(0.0, TORQUE_CUTOFF + STEP / 2, STEP)
    gap, own = np.zeros(len(frequency)), np.zeros((len(signals), len(frequency)))
    cross, averages, total = np.zeros(own.shape, dtype=complex), 0.0, 0
    for segment, rate in enumerate(rows.rates):
        mine = rows.segment == segment
        count = int(mine.sum())
        size = min(count, int(STRETCH * rate))
        if size < 16:
            continue
        grid, power = welch(error[mine], rate, nperseg=size)
        gap += count * np.interp(frequency, grid, power)
        for k, signal in enumerate(signals):
            own[k] += count * np.interp(
                frequency, grid, welch(signal[mine], rate, nperseg=size)[1]
            )
            found = csd(signal[mine], error[mine], rate, nperseg=size)[1]
            cross[k] += count * (
                np.interp(frequency, grid, found.real)
                + 1j * np.interp(frequency, grid, found.imag)
            )
        averages += count / size
        total += count
    return Spectra(
        frequency,
        gap / max(total, 1),
        own / max(total, 1),
        cross / max(total, 1),
        averages,
    )
