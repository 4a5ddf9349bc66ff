"""An alarm while recording: innovations of a filter that point to a change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from arm.errors import InputError
from ident.kalman.change import Hypothesis
from ident.kalman.track import Track

LEVELS = (0.5, 0.9)
"""Quantiles by which the statistic's usual size is judged."""


@dataclass(frozen=True)
class Alarm:
    """What innovations say about one hypothesis, sample by sample.

    Attributes:
        time: when the statistic first crossed the threshold [s], or ``None``.
        statistic: of the window that ends at each sample, over its threshold [1], shape (N,).
    """

    time: float | None
    statistic: np.ndarray


def alarm(
    track: Track, hypothesis: Hypothesis, *, window: float = 0.4, false_alarms: float = 1e-3, settle: float = 2.0
) -> Alarm:
    """Generalised likelihood ratio over a sliding window, with nothing but the past.

    A change D delta adds G_k delta to the innovations e_k, G_k the whitened regressor times D, until the filter
    follows. With F = sum G^T G and u = sum G^T e over the window, u^T F^-1 u is chi-squared with s degrees of freedom
    without a change. Errors of the model widen it: it is divided by how far its median and its 90 % quantile so far
    exceed those of chi-squared. The threshold is the quantile at alpha over the number of samples.

    Args:
        track: of a filter.
        hypothesis: what may change.
        window: length [s].
        false_alarms: alpha, probability of an alarm in a record without change [1].
        settle: time at the start without alarm, in which the filter learns [s].

    Raises:
        InputError: the record is no longer than ``settle``.

    Source: willsky1976.
    """
    s = len(hypothesis.names)
    interval = float(np.median(np.diff(track.t)))
    length = max(2, round(window / interval))
    judged = np.flatnonzero(track.t > track.t[0] + settle)
    if not len(judged) or judged[0] < length:
        raise InputError(f"a record of {track.t[-1] - track.t[0]:.3g} s ends before an alarm may come", where="settle")
    G = track.whitened @ hypothesis.directions
    information = _windowed(np.einsum("kja,kjb->kab", G, G), length)
    score = _windowed(np.einsum("kja,kj->ka", G, track.innovation), length)
    ratio = np.einsum("ka,kab,kb->k", score, np.linalg.pinv(information, hermitian=True, rcond=1e-10), score)
    threshold = chi2.isf(false_alarms / len(judged), s)
    statistic = np.zeros(len(ratio))
    for k in judged:
        usual = np.quantile(ratio[judged[0] - length : k], LEVELS) / chi2.ppf(LEVELS, s)
        statistic[k] = ratio[k] / threshold / max(1.0, usual.max())
    over = np.flatnonzero(statistic > 1)
    return Alarm(float(track.t[over[0]]) if len(over) else None, statistic)


def _windowed(series: np.ndarray, length: int) -> np.ndarray:
    """Sums over the last ``length`` samples along axis 0."""
    total = np.cumsum(series, axis=0)
    out = total.copy()
    out[length:] -= total[:-length]
    return out
