"""Closed-loop output error: position and torque of the simulated closed loop against the measured ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.recording import Recording
from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.estimators.experiment import Experiment, diverged
from gapscope.ident.estimators.simulating import NOT_SETTLED, checked
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.uncertainty.intervals import Uncertainty, jackknife
from gapscope.model.conditioning import TORQUE_CUTOFF, TRIM, low_pass

OVERSAMPLED = 4.0
"""Samples per period of the cut-off that are kept [1]."""


@dataclass(frozen=True)
class OutputError:
    """Minimises the sum of ((q - q_s) / s_q)^2 + ((tau - tau_s) / s_tau)^2 over beta, by trust region.

    q_s and tau_s are those of the closed loop simulated with beta; their derivatives come from sensitivity equations.
    s_q and s_tau are the joints' RMS errors, computed anew in every round. Both sides pass the same low-pass.

    Attributes:
        experiment: how to simulate.
        rounds: of weighting.
        evaluations: of the simulation, at most, per round.
        cutoff: of the low-pass [Hz].
        tolerance: relative change of the sum that ends a round [1].

    Source: walter1997.
    """

    experiment: Experiment
    rounds: int = 2
    evaluations: int = 25
    cutoff: float = TORQUE_CUTOFF
    tolerance: float = 1e-4

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate the base parameters.

        Raises:
            InputError: too few samples, or a problem that is not the experiment's.
            GapscopeError: the simulated arm diverges at the start.
        """
        checked(problem, self.experiment)
        outputs = _Outputs(self)
        measured = outputs.of(self.experiment.recordings)
        beta = self.experiment.start
        try:
            error = measured - outputs.of(self.experiment.simulate(beta))
        except InputError:
            raise
        except GapscopeError as failure:
            raise diverged(failure, 0) from failure
        converged = True
        for _ in range(self.rounds):
            weight = 1.0 / np.maximum(np.sqrt(np.mean(error**2, axis=0)), 1e-12)
            fit = least_squares(
                lambda x, w=weight: ((measured - outputs.at(x)) * w).ravel(),
                beta,
                jac=lambda x, w=weight: (
                    -(outputs.tangents(x) * w[:, None]).reshape(measured.size, -1)
                ),
                x_scale="jac",
                ftol=self.tolerance,
                max_nfev=self.evaluations,
            )
            beta, error, converged = (
                fit.x,
                fit.fun.reshape(error.shape) / weight,
                fit.status > 0,
            )
        warnings = [
            *self.experiment.warnings,
            *([] if converged else [f"output error {NOT_SETTLED}"]),
        ]
        residual = np.sqrt(np.mean(error[:, problem.n_joints :] ** 2, axis=0))
        known = self._uncertainty(fit.jac, fit.fun, error, outputs)
        return Estimate(
            names=problem.names,
            value=beta,
            covariance=known.covariance,
            residual=residual,
            warnings=tuple(warnings),
            freedom=known.freedom,
        )

    def _uncertainty(
        self,
        jacobian: np.ndarray,
        weighted: np.ndarray,
        error: np.ndarray,
        outputs: _Outputs,
    ) -> Uncertainty:
        """That of the estimate, without one stretch of time after the other."""
        tangents = jacobian.reshape(*error.shape, -1)
        recordings = self.experiment.recordings
        lengths = [len(outputs.of([recording])) for recording in recordings]
        group = np.repeat(np.arange(len(lengths)), lengths)
        return jackknife(tangents, tangents, weighted.reshape(error.shape), group)


class _Outputs:
    """Position and torque of an experiment, filtered, trimmed and decimated; the last simulation is kept."""

    def __init__(self, estimator: OutputError) -> None:
        self._experiment, self._cutoff = estimator.experiment, estimator.cutoff
        self._at, self._value = np.empty(0), np.empty(0)
        self._tangents_at, self._tangents = np.empty(0), np.empty(0)

    def of(self, recordings: Sequence[Recording]) -> np.ndarray:
        """Of recordings, shape (M, 2 n)."""
        return np.concatenate(
            [self._filtered(np.hstack([r.q, np.asarray(r.tau)]), r) for r in recordings]
        )

    def at(self, beta: np.ndarray) -> np.ndarray:
        """Simulated, shape (M, 2 n); infinite if the arm diverges, so that the step is taken back."""
        if not np.array_equal(beta, self._at):
            try:
                self._value = self.of(self._experiment.simulate(beta))
            except GapscopeError:
                return np.full_like(self.of(self._experiment.recordings), np.inf)
            self._at = beta.copy()
        return self._value

    def tangents(self, beta: np.ndarray) -> np.ndarray:
        """Derivatives in beta, shape (M, 2 n, b)."""
        if np.array_equal(beta, self._tangents_at):
            return self._tangents
        parts = []
        for recording, by_q, by_tau in self._experiment.tangents(beta):
            both = np.concatenate([by_q, by_tau], axis=1)
            parts.append(self._filtered(both, recording))
        self._tangents = np.concatenate(parts)
        self._tangents_at = beta.copy()
        return self._tangents

    def _filtered(self, series: np.ndarray, recording: Recording) -> np.ndarray:
        rate = recording.rate
        edge, step = int(TRIM * rate), max(1, int(rate / (OVERSAMPLED * self._cutoff)))
        return low_pass(series, rate, self._cutoff)[edge : len(series) - edge : step]
