"""Effective number of independent samples: M / (1 + 2 sum_k rho_k), from what a model leaves [bayley1946].

Samples of a filtered recording resemble their neighbours, so that M of them hold less information than M independent
ones; the residual of a real arm is smooth, and few of its samples are independent. The autocorrelation rho_k at lag k
says how few (``variance_inflation``, its reciprocal per sample), wherever there is a residual: in contrasts, error bars
of parameters, tests of the residual network.

Before a recording exists, or where its content does not matter, the band says how many there can be at most:
``band_samples``, 2 B T over T seconds with bandwidth B, in the least length of a recording and the sample
count of an identification; ``motion_samples``, r T at a fixed rate, in the test for setup faults, which are gross.
"""

from __future__ import annotations

import itertools

import numpy as np

from gapscope.arm.root_mean_square import SMALLEST


def motion_samples(seconds: float, rate: float) -> float:
    """r T: independent samples of a motion of T [s] at a fixed rate r [1/s], whatever its band."""
    return rate * seconds


def band_samples(seconds: float, bandwidth: float) -> float:
    """2 B T: independent samples of one channel in a band of B [Hz] over T [s]. Source: bendat2010."""
    return 2 * bandwidth * seconds


LONGEST = 1000
"""Largest lag that is summed over [1]. (budget)"""


def variance_inflation(residual: np.ndarray, group: np.ndarray) -> np.ndarray:
    """1 + 2 sum_k rho_k per joint [1], at least 1, shape (n,): how many samples count as one.

    The factor by which the variance of a mean, or of a parameter whose regressor is slower than the noise, exceeds
    that of white noise. The sum ends at the first rho_k below 0, or at ``LONGEST`` samples.

    Args:
        residual: shape (N, n).
        group: shape (N,), integers in non-decreasing order.

    Source: bayley1946.
    """
    lags = min(len(residual) - 1, LONGEST)
    covariance = autocovariance(residual, group, lags)
    rho = covariance[1:] / np.maximum(covariance[0], SMALLEST)
    # beyond the first negative value the estimates are noise around zero
    before_first_negative = np.logical_and.accumulate(rho > 0, axis=0)
    return 1 + 2 * (rho * before_first_negative).sum(axis=0)


def low_pass_inflation(cutoff: float, interval: float) -> float:
    """1 + 2 sum_k rho_k of white noise after the low-pass filter [1]: 1 over its mean power gain.

    The filter is that of ``gapscope.model.conditioning.low_pass``.

    Args:
        cutoff: of the filter [Hz]; at Nyquist's frequency and above the filter has no effect.
        interval: between samples [s].
    """
    nyquist = 0.5 / interval
    if cutoff >= nyquist:
        return 1.0
    frequency = (np.arange(4096) + 0.5) / 4096 * nyquist
    # frequencies as the bilinear transform warps them
    warped = np.tan(np.pi * frequency * interval)
    warped_cutoff = np.tan(np.pi * cutoff * interval)
    # order 4, forward and backward: the squared magnitude is the gain of both passes
    gain = 1 / (1 + (warped / warped_cutoff) ** 8)
    return float(1 / (gain**2).mean())


def autocovariance(residual: np.ndarray, group: np.ndarray, lags: int) -> np.ndarray:
    """Autocovariance of series within their groups, shape (lags + 1, n).

    Args:
        residual: shape (N, n); its mean is not subtracted.
        group: shape (N,), integers in non-decreasing order.
        lags: largest lag in samples, below N.
    """
    total = np.zeros((lags + 1, residual.shape[1]))
    for rows in group_slices(group):
        series = residual[rows]
        # padded to twice the length, so that the circular correlation of the FFT is the linear one
        size = 2 ** int(np.ceil(np.log2(2 * len(series))))
        power = np.abs(np.fft.rfft(series, size, axis=0)) ** 2
        correlation = np.fft.irfft(power, size, axis=0)[: min(lags + 1, len(series))]
        total[: len(correlation)] += correlation
    return total / len(residual)


def group_slices(group: np.ndarray) -> list[slice]:
    """Slices of the runs of equal group, in order."""
    inner = (np.flatnonzero(np.diff(group)) + 1).tolist()
    edges = [0, *inner, len(group)]
    return [slice(start, stop) for start, stop in itertools.pairwise(edges)]
