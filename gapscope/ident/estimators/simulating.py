"""Estimators that simulate the loop: instrumental variables, DIDIM, output error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from gapscope.arm.case import Case
from gapscope.arm.control import PD
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.recording import Recording
from gapscope.ident.estimators.experiment import Experiment, diverged
from gapscope.ident.estimators.linear import Estimate, WeightedLeastSquares
from gapscope.ident.intervals import Uncertainty, jackknife
from gapscope.ident.model.base_parameters import BaseParameters
from gapscope.ident.model.linear_problem import (
    SMOOTH,
    FrictionLaw,
    Problem,
    check_samples,
)
from gapscope.ident.model.regressor import Regressor
from gapscope.ident.samples import Samples
from gapscope.model.conditioning import TORQUE_CUTOFF, TRIM, low_pass

# The closed loop of a case: its fitted recordings, and how an estimator that simulates repeats them.


def closed_loop(
    case: Case,
    fit: Sequence[Recording],
    samples: Samples,
    base: BaseParameters,
    problem: Problem,
) -> Experiment:
    """The fitted recordings with their controller, for an estimator that simulates; it starts from least squares.

    Raises:
        InputError: the controller is not known, or a recording cannot be repeated.
    """
    if case.controller is None:
        raise InputError(
            "an estimator that simulates needs the controller that moved the arm",
            "describe it in controller:, or use an estimator that does not simulate",
            file=case.file,
            where="controller",
        )
    if not isinstance(case.controller, PD):
        raise InputError(
            f"an estimator that simulates knows the law pd, not {case.controller.kind}",
            "use an estimator that does not simulate",
            file=case.file,
            where="controller.kind",
        )
    columns, band, law = samples.columns, samples.band, FrictionLaw()
    if columns.coupled:
        raise InputError(
            "an estimator that simulates cannot have motors that turn several joints",
            "use an estimator that does not simulate",
            where="nominal.coupling",
        )

    def build(recordings: Sequence[Recording]) -> Problem:
        own = Samples(columns, band.segments(recordings), band)
        return own.problem(law, base.kept, problem.names)

    # the order of the columns of the model
    quantities = (*SMOOTH, "friction")
    regressor = Regressor(case.arm, columns.body, quantities)
    first = WeightedLeastSquares().estimate(problem).value
    start = base.nearest(first, columns.nominal(law))
    return Experiment(regressor, base, case.controller, fit, build, start)


# What the estimators that simulate have in common: weights, checks, intervals, and how an iteration ends.


HALVINGS = 6
"""How often a step that lets the simulated arm diverge, or fits worse, is halved."""
WORSE = 1.05
"""A step is halved when the error grows by more than this factor [1]."""
NOT_SETTLED = (
    "did not settle: (a) gains, feedforward or reference may not be those of the recording, (b) the start may be too "
    "far from the arm, (c) an effect that the model lacks, such as elasticity or delay, may shape the motion"
)


@dataclass(frozen=True)
class Simulated:
    """Parameters with the problem that the arm simulated with them makes.

    Attributes:
        beta: shape (b,).
        problem: from simulated recordings.
        error: RMS per joint of measured minus simulated torque [N m], shape (n,).
    """

    beta: np.ndarray
    problem: Problem
    error: np.ndarray


def checked(problem: Problem, experiment: Experiment) -> None:
    """Check that a problem belongs to its experiment, and that its samples determine the parameters."""
    experiment.check(problem)
    check_samples(problem)


def started(problem: Problem, experiment: Experiment) -> Simulated:
    """The problem checked, and simulated with the experiment's first parameters.

    Raises:
        InputError: too few samples, or a problem that is not the experiment's.
        GapscopeError: the simulated arm diverges.
    """
    checked(problem, experiment)
    try:
        return simulated(problem, experiment, experiment.start)
    except InputError:
        raise
    except GapscopeError as error:
        raise diverged(error, 0) from error


def simulated(problem: Problem, experiment: Experiment, beta: np.ndarray) -> Simulated:
    """Simulate with parameters beta; raises ``GapscopeError`` if the arm diverges."""
    own = experiment.problem(beta)
    if own.torque.shape != problem.torque.shape:
        raise InputError(
            f"the problem has samples {problem.torque.shape}, its recordings make {own.torque.shape}",
            "make the problem from the recordings of the experiment, in their order",
        )
    return Simulated(
        beta, own, np.sqrt(np.mean((problem.torque - own.torque) ** 2, axis=0))
    )


def improved(
    problem: Problem,
    experiment: Experiment,
    now: Simulated,
    goal: np.ndarray,
    iteration: int,
) -> Simulated:
    """A step towards ``goal``, halved while the arm diverges or the torque fits clearly worse.

    Raises:
        GapscopeError: the arm still diverges after the last halving.
    """
    failure: GapscopeError | None = None
    step = goal - now.beta
    for k in range(HALVINGS):
        try:
            there = simulated(problem, experiment, now.beta + 0.5**k * step)
        except InputError:
            raise
        except GapscopeError as error:
            failure = error
            continue
        if np.mean((there.error / now.error) ** 2) < WORSE**2:
            return there
        failure = None
    if failure is not None:
        raise diverged(failure, iteration) from failure
    return now


def settled(before: Simulated, after: Simulated, tolerance: float) -> bool:
    """Whether error and simulated torque of two iterations agree to a tolerance, relative to the error."""
    change = after.problem.torque - before.problem.torque
    moved = np.sqrt(np.mean(change**2, axis=0))
    return bool((moved <= tolerance * after.error).all())


def estimate_of(
    problem: Problem,
    experiment: Experiment,
    last: Simulated,
    uncertainty: Uncertainty,
    *,
    converged: bool,
    name: str,
) -> Estimate:
    """The estimate that an iteration ends with."""
    warnings = list(experiment.warnings)
    if not converged:
        warnings.append(f"{name} {NOT_SETTLED}")
    return Estimate(
        names=problem.names,
        value=last.beta,
        covariance=uncertainty.covariance,
        residual=last.error,
        warnings=tuple(warnings),
        freedom=uncertainty.freedom,
    )


# DIDIM: direct and inverse dynamic identification; only the torque is compared, the motion is simulated.


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


# IDIM-IV: the inverse dynamic model with instruments from a simulated, noise-free motion.


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


# Closed-loop output error: position and torque of the simulated closed loop against the measured ones.


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
