"""Iteratively reweighted least squares with Huber's loss: outliers pull with bounded force."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve, solve_triangular

from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.estimators.joint_triangles import JointTriangles
from gapscope.ident.estimators.linear_estimator import finished
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.solvable import check_samples

NORMAL_MAD = 0.6745
"""Median absolute deviation of the standard normal distribution."""


@dataclass(frozen=True)
class HuberLeastSquares:
    """Minimises sum rho(e / s_j) with rho(u) = u^2 / 2 for |u| <= k, k |u| - k^2 / 2 beyond.

    s_j [N m] is the median absolute residual of joint j over 0.6745, estimated anew in each round. Covariance
    mean(psi^2) / mean(psi')^2 (W^T W)^-1 in units of s_j, with psi = rho'.

    Attributes:
        threshold: k [1]; 1.345 keeps 95 % of the efficiency under normal noise.
        rounds: most rounds of reweighting.
        tolerance: relative change of the fitted torque at which rounds end.
        start: beta of the first weights, such as the estimate of nearly the same samples, shape (b,); that of least
            squares if ``None``.

    Source: huber1981.
    """

    threshold: float = 1.345
    rounds: int = 50
    tolerance: float = 1e-8
    start: np.ndarray | None = None

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate; raises ``InputError`` if the samples do not determine the parameters."""
        triangles = JointTriangles.of(problem)
        check_samples(problem, rows=triangles.stacked()[:, :-1])
        factor = triangles.factor()
        beta = factor.solve() if self.start is None else self.start
        largest = float(np.abs(problem.torque).max())
        # columns that are orthonormal before weights: their weighted sums of squares are well-conditioned
        triangle = factor.triangle
        square = solve_triangular(triangle, np.eye(len(triangle)))
        columns = problem.matrix @ square
        change = np.inf
        for _ in range(self.rounds):
            following = square @ self._reweighted(problem, columns, beta, largest)
            moved = float(np.abs(problem.matrix @ (following - beta)).max())
            change = moved / max(largest, 1e-300)
            beta = following
            if change < self.tolerance:
                break
        warnings: tuple[str, ...] = ()
        if change > 1e-3:
            warnings = (
                f"reweighting still moved the torque by {change:.1e} after {self.rounds} rounds; give more",
            )
        covariance = self._covariance(problem, triangles, beta, largest)
        return finished(problem, beta, covariance, warnings)

    def _reweighted(
        self,
        problem: Problem,
        columns: np.ndarray,
        beta: np.ndarray,
        largest: float,
    ) -> np.ndarray:
        """Coordinates in other columns (N, n, b) of the fit with Huber's weights min(1, k / |r|) at residuals r."""
        scaled, spread = self._scaled(problem, beta, largest)
        huber = self.threshold / np.maximum(np.abs(scaled), self.threshold)
        weight = huber / spread**2
        flat = columns.reshape(-1, len(beta))
        weighted = flat * weight.reshape(-1, 1)
        return solve(
            weighted.T @ flat, weighted.T @ problem.torque.ravel(), assume_a="pos"
        )

    def _scaled(
        self, problem: Problem, beta: np.ndarray, largest: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals over their joint's spread, (N, n), and the spread [N m], (n,)."""
        residual = problem.residual(beta)
        # the median is not moved by outliers
        spread = np.median(np.abs(residual), axis=0) / NORMAL_MAD
        spread = np.maximum(spread, 1e-9 * max(largest, 1e-300))
        return residual / spread, spread

    def _covariance(
        self,
        problem: Problem,
        triangles: JointTriangles,
        beta: np.ndarray,
        largest: float,
    ) -> np.ndarray:
        """Huber's asymptotic covariance: E[psi^2] / E[psi']^2 (W^T W)^-1 in units of each joint's spread."""
        scaled, spread = self._scaled(problem, beta, largest)
        clipped = np.clip(scaled, -self.threshold, self.threshold)
        inside = float(np.mean(np.abs(scaled) <= self.threshold))
        free = max(1.0 - len(beta) / scaled.size, 1e-3)
        variance = float((clipped**2).mean()) / free / max(inside, 1e-3) ** 2
        return variance * triangles.factor(spread).inverse_gram()
