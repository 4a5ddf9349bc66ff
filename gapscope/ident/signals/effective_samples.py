"""Autocorrelation of residuals: how many samples are worth one."""

from __future__ import annotations

import numpy as np


def autocovariance(residual: np.ndarray, group: np.ndarray, lags: int) -> np.ndarray:
    """Autocovariance of series within their groups, shape (lags + 1, n).

    Args:
        residual: shape (N, n), taken as it is; its mean is part of it.
        group: shape (N,), whole numbers that do not fall.
        lags: largest lag in samples, below N.
    """
    out = np.zeros((lags + 1, residual.shape[1]))
    for part in parts(group):
        series = residual[part]
        size = 2 ** int(np.ceil(np.log2(2 * len(series))))
        power = np.abs(np.fft.rfft(series, size, axis=0)) ** 2
        found = np.fft.irfft(power, size, axis=0)[: min(lags + 1, len(series))]
        out[: len(found)] += found
    return out / len(residual)


def inflation(
    residual: np.ndarray, group: np.ndarray, longest: int = 1000
) -> np.ndarray:
    """1 + 2 sum_k rho_k per joint [1], at least 1, shape (n,): how many samples are worth one.

    The factor by which the variance of a mean, or of a parameter whose regressor is slower than the noise, exceeds
    that of white noise. The sum ends where rho_k first falls below 0, or at ``longest`` samples.
    """
    lags = min(len(residual) - 1, longest)
    covariance = autocovariance(residual, group, lags)
    rho = covariance[1:] / np.maximum(covariance[0], 1e-300)
    alive = np.logical_and.accumulate(rho > 0, axis=0)
    return 1 + 2 * (rho * alive).sum(axis=0)


def low_pass_inflation(cutoff: float, interval: float) -> float:
    """1 + 2 sum_k rho_k of white noise after the low-pass filter [1]: 1 over its mean power gain.

    The filter is that of ``gapscope.ident.signals.conditioning.low_pass``.

    Args:
        cutoff: of the filter [Hz]; at Nyquist's frequency and above nothing was filtered.
        interval: between samples [s].
    """
    if cutoff >= 0.5 / interval:
        return 1.0
    frequency = (np.arange(4096) + 0.5) / 4096 * 0.5 / interval
    gain = 1 / (
        1
        + (np.tan(np.pi * frequency * interval) / np.tan(np.pi * cutoff * interval))
        ** 8
    )
    return float(1 / (gain**2).mean())


def parts(group: np.ndarray) -> list[slice]:
    """The stretches of equal group, in order."""
    edges = np.flatnonzero(np.diff(group)) + 1
    return [
        slice(int(a), int(b))
        for a, b in zip(np.r_[0, edges], np.r_[edges, len(group)], strict=True)
    ]
