"""Maximum likelihood with a noise covariance across the joints, estimated along with the parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from gapscope.arm.errors import InputError
from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.estimators.linear_estimator import Factor, finished
from gapscope.ident.estimators.ols import OrdinaryLeastSquares
from gapscope.ident.model.linear_problem import Problem


@dataclass(frozen=True)
class MaximumLikelihood:
    """Maximises the likelihood of normal noise with covariance Sigma [N m]^2, shape (n, n), over beta and Sigma.

    Alternates beta = (sum_i W_i^T Sigma^-1 W_i)^-1 sum_i W_i^T Sigma^-1 tau_i and Sigma = mean of e_i e_i^T, which
    raises the likelihood in each round. Covariance (sum_i W_i^T Sigma^-1 W_i)^-1.

    Attributes:
        rounds: most rounds.
        tolerance: change of beta, in standard errors, at which rounds end.

    Raises:
        InputError: fewer samples than joints leave Sigma without an inverse.

    Source: swevers2007.
    """

    rounds: int = 100
    tolerance: float = 1e-4

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate; raises ``InputError`` if the samples do not determine the parameters."""
        beta = OrdinaryLeastSquares().estimate(problem).value
        if len(problem.torque) <= problem.n_joints:
            raise InputError(
                f"{len(problem.torque)} samples cannot give the noise of {problem.n_joints} joints and how it "
                "correlates",
                "record for longer, or use ordinary least squares",
                where="samples",
            )
        change = np.inf
        for _ in range(self.rounds):
            factor = Factor.of(*whitened_across(problem, self.noise(problem, beta)))
            following = factor.solve()
            covariance = factor.rest / factor.freedom * factor.inverse_gram()
            change = float(
                np.max(
                    np.abs(following - beta) / np.sqrt(np.diag(covariance)).clip(1e-300)
                )
            )
            beta = following
            if change < self.tolerance:
                break
        warnings: tuple[str, ...] = ()
        if change > 0.1:
            warnings = (
                f"parameters still moved by {change:.2g} standard errors after {self.rounds} rounds; give more",
            )
        return finished(problem, beta, covariance, warnings)

    @staticmethod
    def noise(problem: Problem, beta: np.ndarray) -> np.ndarray:
        """Covariance Sigma of the residual [N m]^2, shape (n, n); kept regular."""
        residual = problem.residual(beta)
        noise = residual.T @ residual / len(residual)
        power = 1e-24 * float((problem.torque**2).sum())
        floor = 1e-12 * max(float(np.trace(noise)), power, 1e-300)
        return noise + floor * np.eye(len(noise))


def whitened_across(
    problem: Problem, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Stacked equations whose noise is white: L^-1 W_i and L^-1 tau_i with L L^T = Sigma, shape (n, n)."""
    root = np.linalg.cholesky(noise)
    inverse = solve_triangular(root, np.eye(len(noise)), lower=True)
    matrix = (inverse @ problem.matrix).reshape(-1, problem.matrix.shape[2])
    return matrix, (problem.torque @ inverse.T).ravel()
