"""Validation: how well the identified model predicts recordings, per joint, and whether the residual is noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfreqz
from scipy.stats import chi2

from gapscope.ident.signals.conditioning import Segment
from gapscope.ident.signals.effective_samples import autocovariance
from gapscope.ident.signals.samples import Band

MOVING = 0.05
"""A joint moves when it is faster than this [rad/s]."""
LAGS = 20
"""Lags of the test for whiteness."""
LEVEL = 1e-3
"""Noise alone fails the test this often."""
Predict = Callable[[Segment], np.ndarray]


@dataclass(frozen=True)
class Errors:
    """Errors of predicted torque on some samples, n joints.

    Attributes:
        rmse: [N m], shape (n,).
        relative: RMS residual over RMS torque [1], shape (n,); NaN if there is no sample.
        largest: [N m], shape (n,).
        overall: RMS residual over RMS torque of all joints together [1].
        share: of the samples that count, per joint [1], shape (n,).
    """

    rmse: np.ndarray
    relative: np.ndarray
    largest: np.ndarray
    overall: float
    share: np.ndarray


@dataclass(frozen=True)
class Whiteness:
    """Whether residuals are what the band leaves of white noise, sampled at the cut-off, n joints.

    Attributes:
        statistic: Ljung and Box's Q over ``LAGS`` lags [1], shape (n,).
        p_value: how often white noise has a larger one, shape (n,).
        largest: largest autocorrelation beyond the band's own at lags from 1 [1], shape (n,).
        bound: what white noise stays below with 99 % probability at any one lag [1].
    """

    statistic: np.ndarray
    p_value: np.ndarray
    largest: np.ndarray
    bound: float

    @property
    def white(self) -> np.ndarray:
        """Joints whose residual may be noise, shape (n,)."""
        return self.p_value > LEVEL


@dataclass(frozen=True)
class Validation:
    """Prediction against a group of recordings.

    Attributes:
        recordings: their names.
        role: ``fit`` or ``judge``.
        every: errors on every sample.
        moving: errors where the joint is faster than ``MOVING``.
        nominal: errors of the nominal arm on every sample.
        whiteness: of the residual.
        t: time, of the segments one after the other [s], shape (M,).
        torque, predicted, before: recorded, predicted and the nominal arm's torque in the band [N m], (M, n).
        velocity: dq [rad/s], (M, n).
        edges: rows at which segments begin, and the end.
    """

    recordings: tuple[str, ...]
    role: str
    every: Errors
    moving: Errors
    nominal: Errors
    whiteness: Whiteness
    t: np.ndarray
    torque: np.ndarray
    predicted: np.ndarray
    before: np.ndarray
    velocity: np.ndarray
    edges: tuple[int, ...]


def validate(
    role: str,
    segments: Sequence[Segment],
    band: Band,
    predict: Predict,
    nominal: Predict,
) -> Validation:
    """Compare predictions with recorded torque, both in the band.

    Args:
        role: ``fit`` or ``judge``.
        segments: with torque.
        band: in which both sides are compared.
        predict: the identified model, segment to torque [N m], (N, n).
        nominal: the nominal arm, likewise.
    """
    parts, lengths = [], [0]
    for segment in segments:
        torque, after, before = (
            band.filtered(x, segment)
            for x in (np.asarray(segment.torque), predict(segment), nominal(segment))
        )
        rows = band.rows(segment)
        parts.append(
            (segment.motion.t[rows], segment.motion.dq[rows], torque, after, before)
        )
        lengths.append(len(torque))
    t, dq, torque, after, before = (np.concatenate(x) for x in zip(*parts, strict=True))
    every, edges = np.full(torque.shape, True), np.cumsum(lengths)
    group = np.repeat(np.arange(len(parts)), lengths[1:])
    names = tuple(dict.fromkeys(segment.recording for segment in segments))
    rate = segments[0].motion.rate
    step = max(1, round(rate / band.cutoff))
    return Validation(
        names,
        role,
        errors(torque, after, every),
        errors(torque, after, np.abs(dq) > MOVING),
        errors(torque, before, every),
        whiteness(
            (torque - after)[::step],
            group[::step],
            band_correlation(rate, band.cutoff, step),
        ),
        t,
        torque,
        after,
        before,
        dq,
        tuple(int(e) for e in edges),
    )


def errors(torque: np.ndarray, predicted: np.ndarray, counted: np.ndarray) -> Errors:
    """Errors [N m] on the samples that count; torque, prediction and mask of shape (N, n)."""
    left = np.where(counted, torque - predicted, 0.0)
    count = counted.sum(axis=0)
    rmse = np.sqrt((left**2).sum(axis=0) / np.maximum(count, 1))
    size = np.sqrt(np.where(counted, torque**2, 0.0).sum(axis=0) / np.maximum(count, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(count > 0, rmse / size, np.nan)
    power = float(np.where(counted, torque**2, 0.0).sum())
    overall = float(np.sqrt((left**2).sum() / power)) if power > 0 else float("nan")
    return Errors(
        rmse, relative, np.abs(left).max(axis=0), overall, count / len(torque)
    )


def band_correlation(rate: float, cutoff: float, step: int) -> np.ndarray:
    """Autocorrelation that the zero-phase low-pass gives white noise at multiples of ``step`` samples, (LAGS + 1,)."""
    frequency, response = sosfreqz(
        butter(4, min(cutoff, 0.95 * rate / 2), output="sos", fs=rate), 4096, fs=rate
    )
    power = np.abs(response) ** 4
    lags = np.arange(LAGS + 1) * step / rate
    found = (power * np.cos(2 * np.pi * lags[:, None] * frequency)).sum(axis=1)
    return np.asarray(found / found[0])


def whiteness(
    residual: np.ndarray, group: np.ndarray, expected: np.ndarray
) -> Whiteness:
    """Ljung and Box's test, Q = N (N + 2) sum_{k=1}^{m} (rho_k - rho0_k)^2 / (N - k), chi-squared of m degrees.

    Args:
        residual: [N m], shape (N, n).
        group: stretch that a sample belongs to, shape (N,).
        expected: rho0, autocorrelation of noise that has passed the band, from lag 0, shape (at least m + 1,).

    Source: ljung1978.
    """
    n = len(residual)
    lags = max(1, min(LAGS, n // 4))
    covariance = autocovariance(residual - residual.mean(axis=0), group, lags)
    rho = (
        covariance[1:] / np.maximum(covariance[0], 1e-300)
        - expected[1 : lags + 1, None]
    )
    statistic = (
        n * (n + 2) * (rho**2 / (n - np.arange(1, lags + 1))[:, None]).sum(axis=0)
    )
    return Whiteness(
        statistic,
        chi2.sf(statistic, lags),
        np.abs(rho).max(axis=0),
        float(2.576 / np.sqrt(n)),
    )
