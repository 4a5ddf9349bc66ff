"""Recursive estimate of base parameters: what a Kalman filter knows after the last sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.ident.estimators.linear import Estimate
from gapscope.ident.kalman import follow
from gapscope.ident.model.linear_problem import Problem


@dataclass(frozen=True)
class Kalman:
    """The last estimate of ``gapscope.ident.kalman.follow``, with the covariance of the filter.

    If friction wanders, it is friction as it was at the end of the last recording.

    Source: ljung1999.
    """

    def estimate(self, problem: Problem) -> Estimate:
        """Filter the samples in their order; raises ``InputError`` if they cannot determine the parameters."""
        track = follow(problem).track
        value = track.value[-1]
        residual = np.sqrt(np.mean(problem.residual(value) ** 2, axis=0))
        return Estimate(
            names=tuple(problem.names),
            value=value,
            covariance=track.covariance[-1],
            residual=residual,
        )
