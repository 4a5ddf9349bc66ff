"""Ordinary least squares."""

from __future__ import annotations

from dataclasses import dataclass

from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.estimators.joint_triangles import JointTriangles
from gapscope.ident.estimators.linear_estimator import finished
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.solvable import check_samples


@dataclass(frozen=True)
class OrdinaryLeastSquares:
    """Minimises |tau - W beta|^2; covariance s^2 (W^T W)^-1 with s^2 = |tau - W beta|^2 / (N n - b).

    That covariance holds for white noise of one size on all joints and a model without error, which filtered
    recordings hardly ever meet; ``gapscope.ident.uncertainty.intervals`` has covariances that need less. Source:
    hollerbach2008.
    """

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate; raises ``InputError`` if the samples do not determine the parameters."""
        triangles = JointTriangles.of(problem)
        check_samples(problem, rows=triangles.stacked()[:, :-1])
        factor = triangles.factor()
        return finished(
            problem,
            factor.solve(),
            factor.rest / factor.freedom * factor.inverse_gram(),
        )
