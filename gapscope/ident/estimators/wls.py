"""Weighted least squares with the noise of each joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.estimators.joint_triangles import JointTriangles
from gapscope.ident.estimators.linear_estimator import Factor, finished
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.solvable import check_rank, check_samples


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
        triangles = JointTriangles.of(problem)
        check_samples(problem, rows=triangles.stacked()[:, :-1])
        factor = self._factor(triangles)
        variance = factor.rest / factor.freedom
        return finished(problem, factor.solve(), variance * factor.inverse_gram())

    def value(self, triangles: JointTriangles) -> np.ndarray:
        """The estimate alone, (b,), of equations that are triangles already.

        Raises:
            InputError: they do not determine the parameters.
        """
        check_rank(triangles.stacked()[:, :-1], triangles.names)
        return self._factor(triangles).solve()

    def _factor(self, triangles: JointTriangles) -> Factor:
        """The factor of all equations by the last noise; that of ordinary least squares at first."""
        factor = triangles.factor()
        # noise and parameters in turns
        for _ in range(self.rounds):
            factor = triangles.factor(triangles.noise(factor.solve()))
        return factor
