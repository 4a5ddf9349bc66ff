"""Uncertainty that holds for autocorrelated residuals: sandwich, block jackknife, intervals.

Filtered recordings have autocorrelated residuals, so that s^2 (W^T W)^-1 states too small errors.
Both methods here use the scores g_i = W_i^T S^-1 e_i, shape (b,), of samples i as they follow each other.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.model.linear_problem import Problem
from gapscope.model.effective_samples import autocovariance, group_slices

MOST_BLOCKS = 200
"""Blocks of the jackknife; more only take longer, as Student's t is normal by then [1]."""


@dataclass(frozen=True)
class Uncertainty:
    """A covariance of parameters and how well it is itself known.

    Attributes:
        covariance: shape (b, b).
        freedom: degrees of freedom of its variances, about the number of independent blocks [1].
        length: samples per block.
    """

    covariance: np.ndarray
    freedom: float
    length: int

    @property
    def deviation(self) -> np.ndarray:
        """Standard errors, shape (b,)."""
        return np.sqrt(np.diag(self.covariance).clip(0.0))

    def interval(
        self, value: np.ndarray, level: float = 0.95
    ) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper end of each parameter's interval, by Student's t; each of shape (b,)."""
        half = student.ppf(0.5 + level / 2, max(self.freedom, 1.0)) * self.deviation
        return value - half, value + half


def block_length(scores: np.ndarray, group: np.ndarray) -> int:
    """Length of blocks [samples] for the variance of a mean: (3 G^2 / (2 g^2))^(1/3) N^(1/3), averaged over columns.

    g = sum_k w_k R_k and G = sum_k w_k |k| R_k with autocovariances R_k and the flat-top window w_k, which is 1 up to
    m, falls to 0 at 2 m, and m is the first lag beyond which the correlation stays within 2 sqrt(log10(N) / N) for
    max(5, sqrt(log10 N)) lags. At least 1, and at most a fifth of the samples. Source: politis2004.

    Args:
        scores: series, shape (N, b).
        group: shape (N,).
    """
    n = len(scores)
    lags = min(n - 1, max(20, int(2 * np.sqrt(n)) + 50))
    covariance = autocovariance(scores - scores.mean(axis=0), group, lags)
    largest = max(float(covariance[0].max()), 1e-300)
    covariance = covariance[:, covariance[0] > 1e-12 * largest]
    lengths = [_column_length(column, n) for column in covariance.T]
    found = [length for length in lengths if length is not None]
    if not found:
        return 1
    return int(np.clip(np.ceil(np.mean(found)), 1, max(1, n // 5)))


def _column_length(covariance: np.ndarray, n: int) -> float | None:
    """Block length of one series of n samples by its autocovariance from lag 0 on; ``None`` if it shows no memory."""
    lags = len(covariance) - 1
    correlation = np.abs(covariance[1:] / covariance[0])
    # m: the first lag after which the correlation is insignificant for several lags in a row
    quiet = correlation < 2 * np.sqrt(np.log10(n) / n)
    stay = max(5, int(np.sqrt(np.log10(n))))
    quiet_runs = np.convolve(quiet, np.ones(stay), "valid") >= stay
    m = int(np.argmax(quiet_runs)) + 1 if quiet_runs.any() else lags // 2
    lag = np.arange(min(2 * m, lags) + 1)
    flat_top = np.clip(2 * (1 - lag / (2 * m)), 0, 1)
    both_sides = np.where(lag == 0, 1.0, 2.0)
    weighted = flat_top * both_sides * covariance[lag]
    density, slope = weighted.sum(), (lag * weighted).sum()
    # a spectrum that dips at frequency 0 says nothing about memory
    if density <= 0.1 * covariance[0]:
        return None
    return float((1.5 * slope**2 / density**2 * n) ** (1 / 3))


def bartlett_sum(scores: np.ndarray, group: np.ndarray, length: int) -> np.ndarray:
    """sum_k (1 - |k| / L) sum_i g_i g_{i+k}^T within the groups, shape (b, b): the variance of the scores' sum.

    Args:
        scores: g_i, shape (N, b).
        group: shape (N,).
        length: L [samples].

    Source: newey1987.
    """
    b = scores.shape[1]
    total = np.zeros((b, b))
    for rows in group_slices(group):
        # sums over all windows of L samples; their products are Bartlett's triangle of weights
        padded = np.vstack(
            [np.zeros((length, b)), scores[rows], np.zeros((length - 1, b))]
        )
        running = np.cumsum(padded, axis=0)
        window_sums = running[length:] - running[:-length]
        total += window_sums.T @ window_sums / length
    return total


def sandwich(
    problem: Problem,
    beta: np.ndarray,
    weight: np.ndarray | None = None,
    length: int | None = None,
) -> Uncertainty:
    """Covariance A^-1 B A^-1 with A = sum W_i^T S W_i, B = sum_k (1 - |k| / L) sum_i g_i g_{i+k}^T (Bartlett's window).

    Args:
        problem: that was solved.
        beta: the estimate, shape (b,).
        weight: S, the inverse noise covariance that the estimator weighted with, shape (n, n); 1 if ``None``.
        length: L [samples]; chosen by ``block_length`` if ``None``.

    The variances have about 1.5 N / L degrees of freedom. Source: newey1987.
    """
    gram, scores = _grams_and_scores(problem, beta, weight)
    if length is None:
        length = block_length(scores, problem.group)
    meat = bartlett_sum(scores, problem.group, length)
    n, b = problem.torque.size, len(beta)
    inverse = _inverse(gram)
    covariance = inverse @ meat @ inverse * n / max(n - b, 1)
    # of Bartlett's window
    freedom = max(1.5 * len(scores) / length - 1, 1.0)
    return Uncertainty(covariance, freedom, length)


def block_jackknife(
    problem: Problem,
    beta: np.ndarray,
    weight: np.ndarray | None = None,
    length: int | None = None,
) -> Uncertainty:
    """Covariance (B - 1) / B sum_k d_k d_k^T with d_k the change of beta when block k of B is left out.

    d_k = (A - A_k)^-1 g_k, A_k and g_k the block's share of A and its summed score: no block tests the parameters
    that it bent itself, which the sandwich forgives: residuals of slow columns hold less slow noise than the noise
    does. Arguments as ``sandwich``; blocks, which do not overlap here, are by default twice as long, and no more than
    about ``MOST_BLOCKS``. Source: kunsch1989, bell2002.
    """
    weighted = problem.matrix if weight is None else weight @ problem.matrix
    residual = problem.residual(beta)
    return jackknife(weighted, problem.matrix, residual, problem.group, length)


def jackknife(
    left: np.ndarray,
    right: np.ndarray,
    residual: np.ndarray,
    group: np.ndarray,
    length: int | None = None,
) -> Uncertainty:
    """The same for any estimate that makes Z^T e zero, with e = y - W beta, or nearly so near the estimate.

    Args:
        left: Z, instruments, or the regressor by its weights, shape (N, m, b).
        right: W, the regressor, or derivatives of what is predicted, shape (N, m, b).
        residual: e, shape (N, m).
        group: shape (N,).
        length: of the blocks [samples]; chosen as in ``block_jackknife`` if ``None``.
    """
    parameters = left.shape[2]
    scores = np.einsum("ijb,ij->ib", left, residual)
    gram = left.reshape(-1, parameters).T @ right.reshape(-1, parameters)
    if length is None:
        enough = -(-len(scores) // MOST_BLOCKS)
        length = max(2 * block_length(scores, group), enough)
    scale = 1 / np.sqrt(np.abs(np.diag(gram)).clip(1e-300))
    changes = []
    for block in _blocks(group, length):
        instruments = left[block].reshape(-1, parameters)
        own = instruments.T @ right[block].reshape(-1, parameters)
        others = (gram - own) * np.outer(scale, scale)
        score = scale * scores[block].sum(axis=0)
        changes.append(scale * np.linalg.lstsq(others, score, rcond=1e-14)[0])
    change, count = np.array(changes), len(changes)
    covariance = (count - 1) / count * change.T @ change
    return Uncertainty(covariance, max(count - 1.0, 1.0), length)


def plain(estimate: Estimate, problem: Problem) -> Uncertainty:
    """What the estimator states itself, with the degrees of freedom of white noise."""
    freedom = max(problem.torque.size - len(estimate.value), 1)
    return Uncertainty(estimate.covariance, float(freedom), 1)


def _grams_and_scores(
    problem: Problem, beta: np.ndarray, weight: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """A, shape (b, b), and the scores of the samples, shape (N, b)."""
    residual = problem.residual(beta)
    weighted = problem.matrix if weight is None else weight @ problem.matrix
    flat = problem.matrix.reshape(-1, len(beta))
    gram = flat.T @ weighted.reshape(-1, len(beta))
    return gram, np.einsum("ijb,ij->ib", weighted, residual)


def _blocks(group: np.ndarray, length: int) -> list[slice]:
    """Blocks of about equal length within the groups."""
    out: list[slice] = []
    for rows in group_slices(group):
        count = max(1, round((rows.stop - rows.start) / length))
        out += equal_parts(rows, count)
    return out


def equal_parts(rows: slice, count: int) -> list[slice]:
    """A slice cut into parts of about equal length, empty ones left out."""
    edges = np.linspace(rows.start, rows.stop, count + 1).astype(int).tolist()
    pairs = itertools.pairwise(edges)
    return [slice(start, stop) for start, stop in pairs if stop > start]


def several_groups(group: np.ndarray) -> list[slice]:
    """The groups; a single one is cut into four."""
    spans = group_slices(group)
    return spans if len(spans) > 1 else equal_parts(spans[0], 4)


def _inverse(gram: np.ndarray) -> np.ndarray:
    """Inverse of a Gram matrix with its diagonal brought to 1 first."""
    scale = 1 / np.sqrt(np.diag(gram).clip(1e-300))
    outer = np.outer(scale, scale)
    return np.linalg.pinv(gram * outer, hermitian=True) * outer
