"""Ordinary least squares."""

from __future__ import annotations

from dataclasses import dataclass

from ident.estimate import Estimate
from ident.estimators.linear import Factor, finished
from ident.problem import Problem
from ident.solvable import check_samples


@dataclass(frozen=True)
class OrdinaryLeastSquares:
    """Minimises |tau - W beta|^2; covariance s^2 (W^T W)^-1 with s^2 = |tau - W beta|^2 / (N n - b).

    That covariance holds for white noise of one size on all joints and a model without error, which filtered
    recordings hardly ever meet; ``ident.uncertainty`` has covariances that need less. Source: hollerbach2008.
    """

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate; raises ``InputError`` where the samples do not determine the parameters."""
        check_samples(problem)
        factor = Factor.of(*problem.stacked())
        return finished(problem, factor.solve(), factor.rest / factor.freedom * factor.inverse_gram())
