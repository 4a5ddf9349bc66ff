"""How likely values of some terms are beside errors of the nominal arm whose size is not known.

With A the columns of the terms, N those of the nuisances, W weights of one over variance, and R_s the root of the
covariance of nuisances of size s,

    y = A theta + N R_s u + e        u ~ N(0, 1), e ~ N(0, W^-1), theta flat or Gaussian
    p(s | y) ~ p(s) |G_s|^-1/2 exp(1/2 r_s^T G_s^-1 r_s)        G_s = X_s^T W X_s + Q, r_s = X_s^T W y

with X_s = [A, N R_s] and Q the prior precision, 1 for u: the restricted likelihood of s [patterson1971].

The errors that the data show tell s. What widens an interval is those that they do not show, as the terms take their
place, and they may be of another size: values are drawn for sizes drawn about those of p(s | y).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from gapscope.diagnosis.model.normal_equations import positive_root
from gapscope.diagnosis.model.nuisance_prior import ErrorSizes


@dataclass(frozen=True)
class Posterior:
    """Values of some terms, Gaussian for one size of the nuisances.

    Attributes:
        columns: places of the terms, (C,).
        mean: of the values, (C,).
        root: B of the values' covariance B B^T, (C, D).
        log_evidence: of the size, up to a constant [nats].
    """

    columns: np.ndarray
    mean: np.ndarray
    root: np.ndarray
    log_evidence: float

    def draws(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Values, (count, C)."""
        noise = rng.normal(size=(count, self.root.shape[1]))
        return np.asarray(self.mean + noise @ self.root.T)


def posteriors(
    total: np.ndarray, columns: np.ndarray, precision: np.ndarray, sizes: ErrorSizes
) -> list[Posterior]:
    """The values under every size.

    Args:
        total: X^T W X of X = [A, N, y], (P + K + 1, P + K + 1).
        columns: places of the terms, (C,).
        precision: prior precision of all P values, zero if flat, (P,).
        sizes: of the K nuisances.
    """
    own = precision[columns]
    used = np.append(columns, np.arange(len(precision), len(total)))
    chosen = total[np.ix_(used, used)]
    return [
        _posterior(chosen, columns, own, root, float(log_prior))
        for root, log_prior in zip(sizes.roots, sizes.log_prior, strict=True)
    ]


def drawn(
    among: Sequence[Sequence[Posterior]],
    unseen: np.ndarray,
    size: int,
    rng: np.random.Generator,
    count: int,
) -> np.ndarray:
    """Values from some sets of terms, each under every size, as likely as the data make either, (count, P).

    Args:
        among: of each set of terms the posteriors under all sizes.
        unseen: see ``ErrorSizes``.
        size: P.
        rng: source of random numbers.
        count: number of draws.
    """
    log_evidence = np.array([[one.log_evidence for one in sizes] for sizes in among])
    chance = np.exp(log_evidence - log_evidence.max()) @ unseen
    counts = rng.multinomial(count, (chance / chance.sum()).ravel())
    out = np.zeros((count, size))
    start = 0
    for one, number in zip(itertools.chain(*among), counts, strict=True):
        rows = slice(start, start + number)
        out[rows, one.columns] = one.draws(rng, number)
        start += number
    return out


def _posterior(
    total: np.ndarray,
    columns: np.ndarray,
    precision: np.ndarray,
    root: np.ndarray,
    log_prior: float,
) -> Posterior:
    """The values under one size: X^T W X over the terms alone, (C + K + 1, C + K + 1), their precision, (C,)."""
    own, errors = len(columns), root.shape[1]
    # from [theta, u, 1] to [theta, delta, 1]
    to_errors = np.zeros((len(total), own + errors + 1))
    to_errors[:own, :own] = np.eye(own)
    to_errors[own:-1, own:-1] = root
    to_errors[-1, -1] = 1.0
    whole = to_errors.T @ total @ to_errors
    gram, right = whole[:-1, :-1], whole[:-1, -1]
    gram += np.diag(np.append(precision, np.ones(errors)))
    scale, lower = positive_root(gram)
    # G = S^-1 L L^T S^-1, so that its inverse is B B^T with B = S L^-T
    inverse = solve_triangular(lower, np.eye(len(lower)), lower=True)
    inverse_root = scale[:, None] * inverse.T
    reduced = inverse_root.T @ right
    log_det = 2.0 * float((np.log(np.diag(lower)) - np.log(scale)).sum())
    proper = float(np.log(precision[precision > 0]).sum())
    log_evidence = log_prior + 0.5 * (float(reduced @ reduced) - log_det + proper)
    return Posterior(
        columns, inverse_root[:own] @ reduced, inverse_root[:own], log_evidence
    )
