"""What the linear estimators share: a triangular factor of the equations, and the estimate that follows from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.model.linear_problem import Problem


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
