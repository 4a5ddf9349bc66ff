"""DIDIM: direct and inverse dynamic identification; only the torque is compared, the motion is simulated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.estimators.experiment import Experiment
from gapscope.ident.estimators.simulating import (
    Simulated,
    estimate_of,
    improved,
    settled,
    started,
)
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.uncertainty.intervals import jackknife


@dataclass(frozen=True)
class DirectInverse:
    """Gauss-Newton on measured minus simulated torque, with the simulated motion's regressor as Jacobian.

    beta <- beta + argmin |S^-1/2 (tau - tau_s(beta) - W_s(beta) d)|, tau_s the torque of the closed loop simulated with
    beta, W_s the regressor of its motion, S the joints' error variances. Measured positions are not used at all, so
    that their noise cannot bias the result. The controller keeps the motion near the reference whatever beta is, which
    is why W_s serves as Jacobian.

    Attributes:
        experiment: how to simulate.
        iterations: at most.
        tolerance: the simulated torque moves by less than this share of the error in the last iteration [1].

    Source: gautier2013.
    """

    experiment: Experiment
    iterations: int = 15
    tolerance: float = 0.01

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate the base parameters.

        Raises:
            InputError: too few samples, or a problem that is not the experiment's.
            GapscopeError: the simulated arm diverges.
        """
        now = started(problem, self.experiment)
        converged = False
        for iteration in range(1, self.iterations + 1):
            matrix, residual = _weighted(problem, now)
            flat = matrix.reshape(residual.size, -1)
            step = np.linalg.lstsq(flat, residual.ravel(), rcond=None)[0]
            # a step that does not lower the error is halved there
            after = improved(problem, self.experiment, now, now.beta + step, iteration)
            converged = settled(now, after, self.tolerance)
            now = after
            if converged:
                break
        matrix, residual = _weighted(problem, now)
        # errors of a simulation follow the motion, so that samples are far from independent
        known = jackknife(matrix, matrix, residual, problem.group)
        return estimate_of(
            problem, self.experiment, now, known, converged=converged, name="DIDIM"
        )


def _weighted(problem: Problem, now: Simulated) -> tuple[np.ndarray, np.ndarray]:
    """Regressor of the simulated motion, (N, n, b), and recorded less simulated torque, (N, n), over the error."""
    weight = 1.0 / np.maximum(now.error, 1e-9)
    residual = (problem.torque - now.problem.torque) * weight
    return now.problem.matrix * weight[:, None], residual
