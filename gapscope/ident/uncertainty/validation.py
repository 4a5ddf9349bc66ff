"""Validation: how well the identified model predicts recordings, per joint, and whether the residual is noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, sosfreqz
from scipy.stats import chi2

from gapscope.ident.signals.samples import Band
from gapscope.model.conditioning import Segment
from gapscope.model.effective_samples import autocovariance

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
        every: errors on every sample whose torque was measured.
        moving: errors while the joint is faster than ``MOVING``.
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
    pieces: list[_Compared] = []
    for segment in segments:
        rows = band.rows(segment)
        pieces.append(
            _Compared(
                t=segment.motion.t[rows],
                dq=segment.motion.dq[rows],
                measured=segment.measured[rows],
                torque=band.filtered(np.asarray(segment.torque), segment),
                after=band.filtered(predict(segment), segment),
                before=band.filtered(nominal(segment), segment),
            )
        )
    whole = _Compared(*(np.concatenate(x) for x in zip(*pieces, strict=True)))
    lengths = [len(piece.t) for piece in pieces]
    edges = np.cumsum([0, *lengths])
    group = np.repeat(np.arange(len(pieces)), lengths)
    names = tuple(dict.fromkeys(segment.recording for segment in segments))
    rate = segments[0].motion.rate
    # the test of whiteness sees the samples that the band holds, not more
    step = max(1, round(rate / band.cutoff))
    every = whole.measured
    residual = np.where(every, whole.torque - whole.after, 0.0)[::step]
    expected = band_correlation(rate, band.cutoff, step)
    moving = np.abs(whole.dq) > MOVING
    return Validation(
        recordings=names,
        role=role,
        every=errors(whole.torque, whole.after, every),
        moving=errors(whole.torque, whole.after, every & moving),
        nominal=errors(whole.torque, whole.before, every),
        whiteness=whiteness(residual, group[::step], expected),
        t=whole.t,
        torque=whole.torque,
        predicted=whole.after,
        before=whole.before,
        velocity=whole.dq,
        edges=tuple(int(edge) for edge in edges),
    )


class _Compared(NamedTuple):
    """Time [s], velocity [rad/s], whether the torque was measured, and torque [N m]: recorded, identified, nominal."""

    t: np.ndarray
    dq: np.ndarray
    measured: np.ndarray
    torque: np.ndarray
    after: np.ndarray
    before: np.ndarray


def errors(torque: np.ndarray, predicted: np.ndarray, counted: np.ndarray) -> Errors:
    """Errors [N m] on the samples that count; torque, prediction and mask of shape (N, n)."""
    residual = np.where(counted, torque - predicted, 0.0)
    counted_torque = np.where(counted, torque, 0.0)
    count = counted.sum(axis=0)
    rmse = np.sqrt((residual**2).sum(axis=0) / np.maximum(count, 1))
    size = np.sqrt((counted_torque**2).sum(axis=0) / np.maximum(count, 1))
    # a joint without samples has no relative error
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(count > 0, rmse / size, np.nan)
    power = float((counted_torque**2).sum())
    overall = float(np.sqrt((residual**2).sum() / power)) if power > 0 else float("nan")
    largest = np.abs(residual).max(axis=0)
    return Errors(
        rmse=rmse,
        relative=relative,
        largest=largest,
        overall=overall,
        share=count / len(torque),
    )


def band_correlation(rate: float, cutoff: float, step: int) -> np.ndarray:
    """Autocorrelation that the zero-phase low-pass gives white noise at multiples of ``step`` samples, (LAGS + 1,)."""
    filter_ = butter(4, min(cutoff, 0.95 * rate / 2), output="sos", fs=rate)
    frequency, response = sosfreqz(filter_, 4096, fs=rate)
    # forward and backward: the power gain is the fourth power of the response
    power = np.abs(response) ** 4
    lags = np.arange(LAGS + 1) * step / rate
    phase = 2 * np.pi * lags[:, None] * frequency
    covariance = (power * np.cos(phase)).sum(axis=1)
    return np.asarray(covariance / covariance[0])


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
    rho = covariance[1:] / np.maximum(covariance[0], 1e-300)
    beyond_band = rho - expected[1 : lags + 1, None]
    pairs = (n - np.arange(1, lags + 1))[:, None]
    statistic = n * (n + 2) * (beyond_band**2 / pairs).sum(axis=0)
    p_value = chi2.sf(statistic, lags)
    # 99 % of the correlations of white noise lie within this
    bound = float(2.576 / np.sqrt(n))
    return Whiteness(
        statistic=statistic,
        p_value=p_value,
        largest=np.abs(beyond_band).max(axis=0),
        bound=bound,
    )
