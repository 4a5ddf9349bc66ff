"""Weights of a sum of functions whose sizes, part by part, are chosen by the evidence of the data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, lapack
from scipy.optimize import minimize

PRIOR_RANGE = (-12.0, 4.0)
"""Range of the logarithm of a part's prior variance, over that of the target."""
NOISE_RANGE = (-9.0, 1.0)
"""Range of the logarithm of the noise variance, likewise."""
ITERATIONS = 25
"""Iterations of the search."""


@dataclass(frozen=True)
class Equations:
    """Normal equations of a weighted fit to N rows of F functions: X^T X, X^T y, y^T y and N."""

    gram: np.ndarray
    moment: np.ndarray
    square: float
    count: float


@dataclass(frozen=True)
class Prior:
    """Prior of the weights.

    Attributes:
        part: number of the part that each function belongs to, (F,).
        log_size: logarithm of each part's variance, shared evenly by its functions, (P,).
        log_noise: logarithm of the noise variance.
        share: share of the rows that count as independent [1].
    """

    part: np.ndarray
    log_size: np.ndarray
    log_noise: float
    share: float

    @property
    def deviation(self) -> np.ndarray:
        """Prior standard deviation of each weight, (F,)."""
        variance = np.exp(self.log_size) / np.bincount(self.part)
        return np.asarray(np.sqrt(variance[self.part]))


def weights(equations: Equations, prior: Prior) -> np.ndarray:
    """Posterior mean, (F,): minimises s |y - X w|^2 / v + sum_i (w_i / d_i)^2."""
    factor, scaled = _whitened(equations, prior)
    return np.asarray(prior.deviation * cho_solve((factor, True), scaled))


def _whitened(equations: Equations, prior: Prior) -> tuple[np.ndarray, np.ndarray]:
    """Cholesky factor of 1 + D X^T X D s / v, and D X^T y s / v, with D the deviations, s / v share over noise."""
    d = prior.deviation
    precision = prior.share / np.exp(prior.log_noise)
    matrix = (d[:, None] * equations.gram * d) * precision
    matrix[np.diag_indices_from(matrix)] += 1.0
    return np.linalg.cholesky(matrix), d * equations.moment * precision


def most_evident(equations: Equations, start: Prior) -> Prior:
    """The prior under which the data are most probable; found by L-BFGS from a first one. Source: mackay1992."""
    parts = len(start.log_size)

    def prior_of(x: np.ndarray) -> Prior:
        return Prior(start.part, x[:-1], float(x[-1]), start.share)

    found = minimize(
        lambda x: _cost(equations, prior_of(x)),
        np.append(start.log_size, start.log_noise),
        jac=True,
        method="L-BFGS-B",
        bounds=[PRIOR_RANGE] * parts + [NOISE_RANGE],
        options={"maxiter": ITERATIONS},
    )
    return prior_of(found.x)


def _cost(equations: Equations, prior: Prior) -> tuple[float, np.ndarray]:
    """Negative logarithm of the evidence, and its gradient by the sizes and the noise, (P + 1,)."""
    factor, scaled = _whitened(equations, prior)
    unit = cho_solve((factor, True), scaled)
    w = prior.deviation * unit
    inverse = lapack.dtrtri(factor, lower=1)[0]
    posterior = (inverse**2).sum(axis=0)
    share, noise = prior.share, np.exp(prior.log_noise)
    count = share * equations.count
    explained = scaled @ unit
    cost = 0.5 * (share * equations.square / noise - explained)
    cost += np.log(np.diag(factor)).sum() + 0.5 * count * prior.log_noise
    free = 1.0 - posterior - unit**2
    by_size = 0.5 * np.bincount(prior.part, free)
    left = equations.square - 2 * w @ equations.moment + w @ equations.gram @ w
    determined = len(w) - posterior.sum()
    by_noise = 0.5 * (count - share * left / noise - determined)
    return float(cost), np.append(by_size, by_noise)
