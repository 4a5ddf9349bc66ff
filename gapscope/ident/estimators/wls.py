"""Weighted least squares with the noise of each joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.estimators.linear_estimator import (
    Factor,
    finished,
    joint_noise,
    whitened,
)
from gapscope.ident.estimators.ols import OrdinaryLeastSquares
from gapscope.ident.model.linear_problem import Problem


@dataclass(frozen=True)
class WeightedLeastSquares:
    """Minimises sum_j |tau_j - W_j beta|^2 / s_j^2; covariance (sum_j W_j^T W_j / s_j^2)^-1.

    The noise s_j [N m] of joint j is what the fit before left of it, ordinary least squares at first.

    Attributes:
        rounds: how often the noise is estimated anew.

    Source: gautier2014.
    """

    rounds: int = 2

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate; raises ``InputError`` if the samples do not determine the parameters."""
        beta: np.ndarray = OrdinaryLeastSquares().estimate(problem).value
        # noise and parameters in turns
        for _ in range(self.rounds):
            noise = joint_noise(problem, beta)
            factor = Factor.of(*whitened(problem, noise))
            beta = factor.solve()
        variance = factor.rest / factor.freedom
        return finished(problem, beta, variance * factor.inverse_gram())
