"""Uncertainty that holds for autocorrelated residuals: sandwich, block jackknife, intervals.

Filtered recordings have residuals that are alike from sample to sample, so that s^2 (W^T W)^-1 states too small errors.
Both methods here use the scores g_i = W_i^T S^-1 e_i, shape (b,), of samples i as they follow each other.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.signals.effective_samples import autocovariance, group_slices


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
    covariance = covariance[
        :, covariance[0] > 1e-12 * max(float(covariance[0].max()), 1e-300)
    ]
    if not covariance.size:
        return 1
    rho, stay = np.abs(covariance / covariance[0]), max(5, int(np.sqrt(np.log10(n))))
    lengths = []
    for k in range(covariance.shape[1]):
        quiet = rho[1:, k] < 2 * np.sqrt(np.log10(n) / n)
        runs = np.convolve(quiet, np.ones(stay), "valid") >= stay
        m = int(np.argmax(runs)) + 1 if runs.any() else lags // 2
        lag = np.arange(min(2 * m, lags) + 1)
        window = np.clip(2 * (1 - lag / (2 * m)), 0, 1) * np.where(lag == 0, 1.0, 2.0)
        density, slope = (
            (window * covariance[lag, k]).sum(),
            (window * lag * covariance[lag, k]).sum(),
        )
        if (
            density <= 0.1 * covariance[0, k]
        ):  # a spectrum that dips at frequency 0 says nothing about memory
            continue
        lengths.append((1.5 * slope**2 / density**2 * n) ** (1 / 3))
    return int(np.clip(np.ceil(np.mean(lengths)) if lengths else 1, 1, max(1, n // 5)))


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
    length = block_length(scores, problem.group) if length is None else length
    meat = np.zeros_like(gram)
    for part in group_slices(problem.group):
        total = np.cumsum(
            np.vstack(
                [
                    np.zeros((length, len(beta))),
                    scores[part],
                    np.zeros((length - 1, len(beta))),
                ]
            ),
            0,
        )
        sums = total[length:] - total[:-length]
        meat += sums.T @ sums / length
    n, b = problem.torque.size, len(beta)
    inverse = _inverse(gram)
    return Uncertainty(
        inverse @ meat @ inverse * n / max(n - b, 1),
        max(1.5 * len(scores) / length - 1, 1.0),
        length,
    )


def block_jackknife(
    problem: Problem,
    beta: np.ndarray,
    weight: np.ndarray | None = None,
    length: int | None = None,
) -> Uncertainty:
    """Covariance (B - 1) / B sum_k d_k d_k^T with d_k the change of beta when block k of B is left out.

    d_k = (A - A_k)^-1 g_k, A_k and g_k the block's share of A and its summed score: no block judges the parameters
    that it bent itself, which the sandwich forgives. Arguments as ``sandwich``; blocks, which do not overlap here, are
    twice as long by default. Source: kunsch1989.
    """
    gram, scores = _grams_and_scores(problem, beta, weight)
    length = 2 * block_length(scores, problem.group) if length is None else length
    scale = 1 / np.sqrt(np.diag(gram).clip(1e-300))
    changes = []
    for block in _blocks(problem.group, length):
        rows = problem.matrix[block]
        weighted = rows if weight is None else weight @ rows
        own = rows.reshape(-1, len(beta)).T @ weighted.reshape(-1, len(beta))
        rest, pull = (
            (gram - own) * np.outer(scale, scale),
            scale * scores[block].sum(axis=0),
        )
        changes.append(scale * np.linalg.lstsq(rest, pull, rcond=1e-14)[0])
    found = np.array(changes)
    count = len(found)
    return Uncertainty(
        (count - 1) / count * found.T @ found, max(count - 1.0, 1.0), length
    )


def plain(estimate: Estimate, problem: Problem) -> Uncertainty:
    """What the estimator states itself, with the degrees of freedom of white noise."""
    return Uncertainty(
        estimate.covariance, float(max(problem.torque.size - len(estimate.value), 1)), 1
    )


def _grams_and_scores(
    problem: Problem, beta: np.ndarray, weight: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """A, shape (b, b), and the scores of the samples, shape (N, b)."""
    residual = problem.residual(beta)
    weighted = problem.matrix if weight is None else weight @ problem.matrix
    flat = problem.matrix.reshape(-1, len(beta))
    return flat.T @ weighted.reshape(-1, len(beta)), np.einsum(
        "ijb,ij->ib", weighted, residual
    )


def _blocks(group: np.ndarray, length: int) -> list[slice]:
    """Blocks of about equal length within the groups."""
    out = []
    for part in group_slices(group):
        count = max(1, round((part.stop - part.start) / length))
        edges = np.linspace(part.start, part.stop, count + 1).astype(int)
        out += [slice(int(a), int(b)) for a, b in itertools.pairwise(edges) if b > a]
    return out


def _inverse(gram: np.ndarray) -> np.ndarray:
    """Inverse of a Gram matrix with its diagonal brought to 1 first."""
    scale = 1 / np.sqrt(np.diag(gram).clip(1e-300))
    return np.linalg.pinv(gram * np.outer(scale, scale), hermitian=True) * np.outer(
        scale, scale
    )
