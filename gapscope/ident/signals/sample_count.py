"""How many independent samples a motion gives for each parameter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.ident.signals.samples import Samples
from gapscope.model.effective_samples import band_samples, group_slices

ADVISED = 10.0
"""Independent samples per base parameter below which there is a warning [1]."""
POWER = 0.99
"""Share of the torque's power that lies within its bandwidth [1]."""


@dataclass(frozen=True)
class SampleCount:
    """How much information the fitted recordings hold.

    Attributes:
        seconds: length of the fitted samples [s].
        bandwidth: frequency below which ``POWER`` of the torque's power about its mean lies [Hz], shape (n,).
        independent: sum_j 2 B_j T, the independent samples of all joints [1].
        parameters: number of base parameters.
    """

    seconds: float
    bandwidth: np.ndarray
    independent: float
    parameters: int

    @property
    def per_parameter(self) -> float:
        """Independent samples per base parameter [1]."""
        return self.independent / self.parameters

    def warnings(self, *, model_error: bool) -> tuple[str, ...]:
        """A warning if there are fewer than ``ADVISED`` per parameter, or none.

        Args:
            model_error: whether the residual follows the motion; then faster motion only hides what the model lacks.
        """
        if self.per_parameter >= ADVISED:
            return ()
        needed = self.seconds * ADVISED / max(self.per_parameter, 1e-3)
        faster = "" if model_error else ", or move faster"
        return (
            f"{self.seconds:.3g} s of motion up to {self.bandwidth.max():.2g} Hz hold about {self.per_parameter:.1f} "
            f"independent samples per base parameter, {ADVISED:g} are advised: intervals and validation say less than "
            f"they seem to; record for {needed:.2g} s{faster}",
        )


def count_samples(samples: Samples, parameters: int) -> SampleCount:
    """Count by the bandwidth B of the recorded torque: a band of B Hz holds 2 B independent samples a second."""
    seconds = len(samples.torque) * samples.interval
    bandwidth = _bandwidth(samples)
    return SampleCount(
        seconds=seconds,
        bandwidth=bandwidth,
        independent=band_samples(seconds, float(bandwidth.sum())),
        parameters=parameters,
    )


def _bandwidth(samples: Samples) -> np.ndarray:
    """Frequency below which ``POWER`` of the power of each joint's torque lies [Hz], shape (n,)."""
    nyquist = 0.5 / samples.interval
    grid = np.linspace(0.0, min(samples.band.cutoff, nyquist), 512)
    power = np.zeros((len(grid), samples.torque.shape[1]))
    for rows in group_slices(samples.group):
        series = samples.torque[rows] - samples.torque[rows].mean(axis=0)
        window = np.hanning(len(series))[:, None]
        density = np.abs(np.fft.rfft(series * window, axis=0)) ** 2
        frequency = np.fft.rfftfreq(len(series), samples.interval)
        # groups differ in length: their spectra are added on a common grid
        for joint, column in enumerate(density.T):
            power[:, joint] += np.interp(grid, frequency, column)
    total = np.maximum(power.sum(axis=0), 1e-300)
    share_below = np.cumsum(power, axis=0) / total
    return np.asarray(grid[np.argmax(share_below >= POWER, axis=0)])
