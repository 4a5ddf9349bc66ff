"""Recursive estimate of base parameters: what a Kalman filter knows after the last sample."""

from __future__ import annotations

from dataclasses import dataclass

from gapscope.ident.estimators.linear import Estimate, finished
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
        return finished(problem, track.value[-1], track.covariance[-1])
