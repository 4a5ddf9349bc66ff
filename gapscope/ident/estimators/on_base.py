"""An estimator of standard parameters, asked for base parameters."""

from __future__ import annotations

from dataclasses import dataclass

from gapscope.ident.estimators.estimate import Estimate, Estimator
from gapscope.ident.estimators.linear_estimator import finished
from gapscope.ident.model.base_parameters import BaseParameters
from gapscope.ident.model.linear_problem import Problem


@dataclass(frozen=True)
class OnBase:
    """Estimates pi on W C, then states beta = C pi with covariance C S C^T; W the base columns, shape (N, n, b).

    Attributes:
        inner: estimates pi, shape (p,).
        base: C, shape (b, p).
    """

    inner: Estimator
    base: BaseParameters

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate base parameters; raises what ``inner`` raises."""
        C = self.base.combination
        whole = Problem(
            problem.matrix @ C,
            problem.torque,
            self.base.names,
            problem.group,
            problem.interval,
        )
        found = self.inner.estimate(whole)
        return finished(
            problem, C @ found.value, C @ found.covariance @ C.T, found.warnings
        )
