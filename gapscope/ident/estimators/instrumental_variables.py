"""IDIM-IV: the inverse dynamic model with instruments from a simulated, noise-free motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

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
class InstrumentalVariables:
    """beta <- (Z^T S^-1 W)^-1 Z^T S^-1 tau, with Z the regressor of the closed loop simulated with the beta before.

    W is made from measured positions, whose noise enters their derivatives and, through the controller, the torque;
    least squares are biased by it. Z does not depend on that noise, and is correlated with the true W.

    Attributes:
        experiment: how to simulate.
        iterations: at most.
        tolerance: the simulated torque moves by less than this share of the error in the last iteration [1].

    Source: janot2014.
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
            goal = self._solved(problem, now)
            after = improved(problem, self.experiment, now, goal, iteration)
            converged = settled(now, after, self.tolerance)
            now = after
            if converged:
                break
        beta = self._solved(problem, now) if converged else now.beta
        residual = problem.residual(beta)
        weight = 1.0 / np.maximum(np.sqrt(np.mean(residual**2, axis=0)), 1e-9)
        scale = weight[:, None]
        known = jackknife(
            now.problem.matrix * scale,
            problem.matrix * scale,
            residual * weight,
            problem.group,
        )
        last = replace(now, beta=beta, error=1.0 / weight)
        return estimate_of(
            problem,
            self.experiment,
            last,
            known,
            converged=converged,
            name="IDIM-IV",
        )

    @staticmethod
    def _solved(problem: Problem, now: Simulated) -> np.ndarray:
        """The parameters that the instruments of a simulation give, shape (b,)."""
        rms = np.sqrt(np.mean(problem.residual(now.beta) ** 2, axis=0))
        weight = 1.0 / np.maximum(rms, 1e-9)
        Z = now.problem.matrix * weight[:, None] ** 2
        gram = np.einsum("ija,ijb->ab", Z, problem.matrix)
        right = np.einsum("ija,ij->a", Z, problem.torque)
        own = np.einsum("ija,ija->a", Z, now.problem.matrix)
        scale = np.sqrt(np.abs(own))
        return np.linalg.solve(gram / np.outer(scale, scale), right / scale) / scale
