"""What the linear estimators share: a triangular factor of the equations, and the estimate that follows from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.model.friction_trials import stretches
from gapscope.ident.model.linear_problem import Problem
from gapscope.model.effective_samples import group_slices


@dataclass(frozen=True)
class Factor:
    """Equations W beta = tau of any number of rows as a triangle: |tau - W beta|^2 = |z - R beta|^2 + rest.

    Attributes:
        triangle: R, shape (b, b).
        rotated: z, shape (b,).
        rest: squared norm of what no beta explains.
        rows: number of equations.
    """

    triangle: np.ndarray
    rotated: np.ndarray
    rest: float
    rows: int

    @classmethod
    def of(cls, matrix: np.ndarray, torque: np.ndarray) -> Factor:
        """The factor of equations, matrix of shape (M, b) and torque of shape (M,)."""
        b = matrix.shape[1]
        equations = np.column_stack([matrix, torque])
        triangle = np.asarray(np.linalg.qr(equations, mode="r"))
        # fewer equations than columns: rows of zeros complete the triangle
        missing = max(0, b + 1 - len(triangle))
        triangle = np.vstack([triangle, np.zeros((missing, b + 1))])
        rest = float(triangle[b, b] ** 2)
        return cls(
            triangle=triangle[:b, :b],
            rotated=triangle[:b, b],
            rest=rest,
            rows=len(matrix),
        )

    @property
    def freedom(self) -> int:
        """Equations less parameters, at least 1."""
        return max(self.rows - len(self.rotated), 1)

    def solve(self) -> np.ndarray:
        """The least-squares beta, shape (b,); R must be regular."""
        return solve_triangular(self.triangle, self.rotated)

    def inverse_gram(self) -> np.ndarray:
        """(W^T W)^-1, shape (b, b); R must be regular."""
        inverse = solve_triangular(self.triangle, np.eye(len(self.triangle)))
        return inverse @ inverse.T


def held_out_squares(
    problem: Problem,
    prior: np.ndarray,
    filters: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """Mean squared residual [N^2 m^2] of each motion by pull, (F, K), fitted without it; F motions, K pulls.

    A motion is a recording, or, of fewer than three, a stretch of time.

    Args:
        problem: to be solved.
        prior: beta_0, shape (b,).
        filters: factors 1 / (s_i^2 + ...) of K pulls along the singular directions, (K, b), from the squared singular
            values of unit columns, (b,), ascending.
    """
    parts = group_slices(problem.group)
    if len(parts) < 3:
        parts = stretches(problem.group)
    norms = column_norms(problem.stacked()[0])
    left = problem.torque - problem.matrix @ prior
    scaled = np.concatenate([problem.matrix / norms, left[..., None]], axis=2)
    flat = [scaled[rows].reshape(-1, scaled.shape[2]) for rows in parts]
    grams = [rows.T @ rows for rows in flat]
    squares = []
    for rows, gram in zip(flat, grams, strict=True):
        others = np.sum(grams, axis=0) - gram
        values, vectors = np.linalg.eigh(others[:-1, :-1])
        part = vectors.T @ others[:-1, -1]
        change = (filters(np.maximum(values, 0.0)) * part) @ vectors.T
        residual = rows[:, -1] - change @ rows[:, :-1].T
        squares.append((residual**2).mean(axis=1))
    return np.array(squares)


def strongest_as_good(squares: np.ndarray) -> int:
    """The last of K pulls, the strongest, that predicts F motions as well as the best within two standard errors.

    Other motions may show more than these: where they cannot tell, the prior is kept. ``squares`` has shape (F, K).
    """
    best = int(squares.mean(axis=0).argmin())
    worse = squares - squares[:, best : best + 1]
    error = worse.std(axis=0, ddof=1) / np.sqrt(len(worse))
    return int(np.flatnonzero(worse.mean(axis=0) <= 2 * error).max())


def whitened(problem: Problem, spread: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stacked equations divided by each joint's noise [N m], shape (n,): W of shape (N n, b), tau of shape (N n,)."""
    matrix = problem.matrix / spread[:, None]
    torque = problem.torque / spread
    return matrix.reshape(-1, matrix.shape[2]), torque.ravel()


def joint_noise(problem: Problem, beta: np.ndarray) -> np.ndarray:
    """Standard deviation of the residual per joint [N m], shape (n,): parameters counted, and nowhere zero."""
    residual = problem.residual(beta)
    free = max(1.0 - len(beta) / residual.size, 1.0 / residual.size)
    noise = np.sqrt((residual**2).mean(axis=0) / free)
    # an exact fit has no noise, but weights must be finite
    return least_noise(noise, float(np.abs(problem.torque).max(initial=0.0)))


def least_noise(noise: np.ndarray, largest_torque: float) -> np.ndarray:
    """Noise of the joints [N m], (n,), of which none is zero."""
    least = max(1e-12 * max(largest_torque, 1e-300), 1e-6 * float(noise.max(initial=0)))
    return np.maximum(noise, least)


def column_norms(matrix: np.ndarray) -> np.ndarray:
    """Norms of columns to divide by, shape (b,); 1 for a column of zeros."""
    norms = np.linalg.norm(matrix, axis=0)
    return np.where(norms > 0, norms, 1.0)


def scaled_inverse(matrix: np.ndarray) -> np.ndarray:
    """Pseudo-inverse of a symmetric matrix, computed with its diagonal brought to 1."""
    scale = 1 / np.sqrt(np.diag(matrix))
    outer = np.outer(scale, scale)
    return np.linalg.pinv(matrix * outer, hermitian=True) * outer


def finished(
    problem: Problem,
    beta: np.ndarray,
    covariance: np.ndarray,
    warnings: tuple[str, ...] = (),
) -> Estimate:
    """The estimate with what it leaves per joint."""
    residual = np.sqrt((problem.residual(beta) ** 2).mean(axis=0))
    return Estimate(
        names=tuple(problem.names),
        value=beta,
        covariance=covariance,
        residual=residual,
        warnings=warnings,
    )
