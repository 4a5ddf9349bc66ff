"""An alarm while recording: innovations of a filter that point to a change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as fisher

from gapscope.arm.errors import InputError
from gapscope.ident.kalman.change_hypothesis import ChangeHypothesis
from gapscope.ident.kalman.track import Track

LEVELS = (0.5, 0.9)
"""Quantiles that measure the statistic's usual size."""
FEW = 3
"""From this many joints on a change has to show without any one of them; friction errs on one joint at a time."""


MARGIN = 2.0
"""Errors of the model may exceed what they did before: of 60 recordings without change two came to 1.05 and 1.55 times
the threshold without this factor on it."""


@dataclass(frozen=True)
class Alarm:
    """Evidence of the innovations for one hypothesis, sample by sample.

    Attributes:
        time: when the statistic first crossed the threshold [s], or ``None``.
        statistic: of the window that ends at each sample, over its threshold [1], shape (N,).
    """

    time: float | None
    statistic: np.ndarray


def alarm(
    track: Track,
    hypothesis: ChangeHypothesis,
    *,
    window: float = 0.5,
    false_alarms: float = 1e-3,
    settle: float = 2.0,
) -> Alarm:
    """Generalised likelihood ratio over a sliding window, causal.

    A change D delta adds G_k delta to the innovations e_k, G_k the whitened regressor times D, until the filter
    follows. With sigma_j the RMS of the innovations of joint j up to the window, F_j = sum G_j^T G_j / sigma_j^2 and
    u_j = sum G_j^T e_j / sigma_j^2 over the window, F and u their sums over the joints, u^T F^-1 u is s times an
    F-variable of s and m degrees of freedom without a change, m the samples that sigma was learnt from. The least of
    these ratios counts when each joint in turn is left out: a load shows on several joints, an error of the friction on
    one. Errors of the model widen it: it is divided by how far its median and its 90 % quantile so far exceed those of
    chi-squared. The threshold is ``MARGIN`` times the quantile at alpha over the number of samples.

    Args:
        track: of a filter.
        hypothesis: what may change.
        window: length [s].
        false_alarms: alpha, probability of an alarm in a record without change [1].
        settle: time at the start without alarm [s]; in its first half the filter settles, in its second sigma is
            learnt.

    Raises:
        InputError: the record is no longer than ``settle``, or ``settle`` no longer than four windows.

    Source: willsky1976.
    """
    interval = float(np.median(np.diff(track.t)))
    length = max(2, round(window / interval))
    since = track.t - track.t[0]
    first = int(np.searchsorted(since, settle / 2))
    watched = np.flatnonzero(since > settle)
    begin = first + length
    if not len(watched) or watched[0] <= begin + length:
        raise InputError(
            f"a record of {since[-1]:.3g} s ends before an alarm may come, or an alarm may come after {settle:.3g} s "
            f"before its noise is known",
            f"record for longer, and settle for more than {4 * window:.3g} s",
            where="settle",
        )
    ratio, learnt = _ratios(track, hypothesis.directions, length, first)
    s = len(hypothesis.names)
    quantile = fisher.isf(false_alarms / len(watched), s, np.maximum(learnt, 1))
    threshold = MARGIN * s * quantile
    expected = chi2.ppf(LEVELS, s)
    statistic = np.zeros(len(ratio))
    for k in watched:
        # the window that is judged is left out of what is usual
        usual = np.quantile(ratio[begin : k - length], LEVELS) / expected
        statistic[k] = ratio[k] / threshold[k] / max(1.0, usual.max())
    # the first crossing is the alarm
    over = np.flatnonzero(statistic > 1)
    time = float(track.t[over[0]]) if len(over) else None
    return Alarm(time, statistic)


def _ratios(
    track: Track, directions: np.ndarray, length: int, first: int
) -> tuple[np.ndarray, np.ndarray]:
    """Likelihood ratios of the windows that end at each sample, and the samples that their noise was learnt from.

    Args:
        track: of a filter.
        directions: D, shape (b, s).
        length: samples of a window.
        first: sample from which on the noise is learnt.
    """
    count, n = track.innovation.shape
    sample = np.arange(count)
    # the noise is learnt from ``first`` up to where the window begins
    learnt = np.maximum(sample - length - first + 1, 0)
    learning = (sample >= first)[:, None]
    squares = np.cumsum(track.innovation**2 * learning, axis=0)
    before_window = np.concatenate([np.zeros((length, n)), squares[:-length]])
    precision = learnt[:, None] / np.maximum(before_window, 1e-300)
    G = track.whitened @ directions
    products = np.einsum("kja,kjb->kjab", G, G)
    information = precision[..., None, None] * _windowed(products, length)
    projected = G * track.innovation[..., None]
    score = precision[..., None] * _windowed(projected, length)
    ratios = []
    for joints in _joint_sets(n):
        own_information = information[:, joints].sum(axis=1)
        own_score = score[:, joints].sum(axis=1)
        ratios.append(_ratio(own_information, own_score))
    return np.min(ratios, axis=0), learnt


def _joint_sets(n: int) -> list[np.ndarray]:
    """Masks of the joints that a change has to show on: all but one in turn, or all if there are few."""
    if n < FEW:
        return [np.ones(n, dtype=bool)]
    return [np.arange(n) != j for j in range(n)]


def _ratio(information: np.ndarray, score: np.ndarray) -> np.ndarray:
    """u^T F^-1 u of each sample, shape (N,)."""
    inverse = np.linalg.pinv(information, hermitian=True, rcond=1e-10)
    return np.einsum("ka,kab,kb->k", score, inverse, score)


def _windowed(series: np.ndarray, length: int) -> np.ndarray:
    """Sums over the last ``length`` samples along axis 0."""
    total = np.cumsum(series, axis=0)
    out = total.copy()
    out[length:] -= total[:-length]
    return out
