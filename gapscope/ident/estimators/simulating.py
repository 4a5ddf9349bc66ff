"""Estimators that simulate the loop: instrumental variables, DIDIM, output error."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.optimize import least_squares

from gapscope.arm.case import Case
from gapscope.arm.control import PD
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import rms
from gapscope.ident.estimators.experiment import Experiment
from gapscope.ident.estimators.linear import Estimate, WeightedLeastSquares
from gapscope.ident.intervals import Uncertainty, jackknife
from gapscope.ident.model.base_parameters import TINY, BaseParameters
from gapscope.ident.model.linear_problem import (
    SMOOTH,
    FrictionLaw,
    Problem,
)
from gapscope.ident.model.regressor import Regressor
from gapscope.ident.samples import PER_CUTOFF, Samples
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


# What the estimators that simulate have in common: checks, steps, and how an iteration ends.


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


@dataclass(frozen=True)
class _Simulating:
    """An estimator that repeats the recordings, beta by beta, until the simulated torque stays.

    Attributes:
        experiment: how to simulate.
        iterations: at most.
        tolerance: the simulated torque moves by less than this share of the error in the last iteration [1].
    """

    name: ClassVar[str]
    experiment: Experiment
    iterations: int = 15
    tolerance: float = 0.01

    def goal(self, problem: Problem, now: Simulated) -> np.ndarray:
        """The parameters that a simulation asks for next, shape (b,)."""
        raise NotImplementedError

    def iterated(self, problem: Problem) -> tuple[Simulated, tuple[str, ...]]:
        """The last simulation, and what makes it doubtful: its last entry, if it did not settle.

        Raises:
            InputError: too few samples, or a problem that is not the experiment's.
            GapscopeError: the simulated arm diverges.
        """
        self.experiment.check(problem)
        with _divergence(0):
            now = self._simulated(problem, self.experiment.start)
        for iteration in range(1, self.iterations + 1):
            before, now = now, self._improved(problem, now, iteration)
            moved = now.problem.torque - before.problem.torque
            if (rms(moved) <= self.tolerance * now.error).all():
                return now, self.experiment.warnings
        return now, (*self.experiment.warnings, f"{self.name} {NOT_SETTLED}")

    def _simulated(self, problem: Problem, beta: np.ndarray) -> Simulated:
        """Simulate with parameters beta; raises ``GapscopeError`` if the arm diverges."""
        own = self.experiment.problem(beta)
        if own.torque.shape != problem.torque.shape:
            raise InputError(
                f"the problem has samples {problem.torque.shape}, its recordings make {own.torque.shape}",
                "make the problem from the recordings of the experiment, in their order",
            )
        return Simulated(beta, own, rms(problem.torque - own.torque))

    def _improved(self, problem: Problem, now: Simulated, iteration: int) -> Simulated:
        """A step towards the goal, halved while the arm diverges or the torque fits clearly worse.

        Raises:
            GapscopeError: the arm still diverges after the last halving.
        """
        step = self.goal(problem, now) - now.beta
        for k in range(HALVINGS):
            last = k == HALVINGS - 1
            with _divergence(iteration) if last else suppress(GapscopeError):
                there = self._simulated(problem, now.beta + 0.5**k * step)
                if np.mean((there.error / now.error) ** 2) < WORSE**2:
                    return there
        return now


@contextmanager
def _divergence(iteration: int) -> Iterator[None]:
    """Say of a simulated arm that diverges in which iteration, and why that may be."""
    try:
        yield
    except InputError:
        raise
    except GapscopeError as error:
        raise GapscopeError(
            f"the simulated arm diverged in iteration {iteration} ({error.message})",
            "check (a) that gains, feedforward and reference are those of the recording, (b) that the start is near "
            "the arm: take the estimate of a linear estimator, or the data sheet, as the prior, (c) that the motion "
            "excites every parameter, so that no estimate makes the mass matrix negative",
        ) from error


def _estimate(
    problem: Problem,
    beta: np.ndarray,
    residual: np.ndarray,
    known: Uncertainty,
    warnings: tuple[str, ...],
) -> Estimate:
    """The estimate with the interval that belongs to it."""
    return Estimate(
        problem.names, beta, known.covariance, residual, warnings, known.freedom
    )


# DIDIM: direct and inverse dynamic identification; only the torque is compared, the motion is simulated.


@dataclass(frozen=True)
class DirectInverse(_Simulating):
    """Gauss-Newton on measured minus simulated torque, with the simulated motion's regressor as Jacobian.

    beta <- beta + argmin |S^-1/2 (tau - tau_s(beta) - W_s(beta) d)|, tau_s the torque of the closed loop simulated with
    beta, W_s the regressor of its motion, S the joints' error variances. Measured positions are not used at all, so
    that their noise cannot bias the result. The controller keeps the motion near the reference whatever beta is, which
    is why W_s serves as Jacobian.

    Source: gautier2013.
    """

    name = "DIDIM"

    def goal(self, problem: Problem, now: Simulated) -> np.ndarray:
        """The end of the Gauss-Newton step."""
        matrix, residual = _weighted(problem, now)
        flat = matrix.reshape(residual.size, -1)
        return now.beta + np.linalg.lstsq(flat, residual.ravel(), rcond=None)[0]

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate the base parameters; raises what ``iterated`` raises."""
        now, warnings = self.iterated(problem)
        matrix, residual = _weighted(problem, now)
        # errors of a simulation follow the motion, so that samples are far from independent
        known = jackknife(matrix, matrix, residual, problem.group)
        return _estimate(problem, now.beta, now.error, known, warnings)


def _weighted(problem: Problem, now: Simulated) -> tuple[np.ndarray, np.ndarray]:
    """Regressor of the simulated motion, (N, n, b), and recorded less simulated torque, (N, n), over the error."""
    weight = 1.0 / np.maximum(now.error, TINY)
    residual = (problem.torque - now.problem.torque) * weight
    return now.problem.matrix * weight[:, None], residual


# IDIM-IV: the inverse dynamic model with instruments from a simulated, noise-free motion.


@dataclass(frozen=True)
class InstrumentalVariables(_Simulating):
    """beta <- (Z^T S^-1 W)^-1 Z^T S^-1 tau, with Z the regressor of the closed loop simulated with the beta before.

    W is made from measured positions, whose noise enters their derivatives and, through the controller, the torque;
    least squares are biased by it. Z does not depend on that noise, and is correlated with the true W.

    Source: janot2014.
    """

    name = "IDIM-IV"

    def goal(self, problem: Problem, now: Simulated) -> np.ndarray:
        """What the instruments of a simulation give."""
        weight = 1.0 / np.maximum(rms(problem.residual(now.beta)), TINY)
        Z = now.problem.matrix * weight[:, None] ** 2
        gram = np.einsum("ija,ijb->ab", Z, problem.matrix)
        right = np.einsum("ija,ij->a", Z, problem.torque)
        own = np.einsum("ija,ija->a", Z, now.problem.matrix)
        scale = np.sqrt(np.abs(own))
        return np.linalg.solve(gram / np.outer(scale, scale), right / scale) / scale

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate the base parameters; raises what ``iterated`` raises."""
        now, warnings = self.iterated(problem)
        settled = warnings == self.experiment.warnings
        beta = self.goal(problem, now) if settled else now.beta
        residual = problem.residual(beta)
        error = np.maximum(rms(residual), TINY)
        known = jackknife(
            now.problem.matrix / error[:, None],
            problem.matrix / error[:, None],
            residual / error,
            problem.group,
        )
        return _estimate(problem, beta, error, known, warnings)


# Closed-loop output error: position and torque of the simulated closed loop against the measured ones.


ROUNDS = 2
"""Rounds of weighting."""
EVALUATIONS = 25
"""Simulations of a round, at most."""
SUM_SETTLED = 1e-4
"""Relative change of the sum of squares that ends a round [1]."""


@dataclass(frozen=True)
class OutputError:
    """Minimises the sum of ((q - q_s) / s_q)^2 + ((tau - tau_s) / s_tau)^2 over beta, by trust region.

    q_s and tau_s are those of the closed loop simulated with beta; their derivatives come from sensitivity equations.
    s_q and s_tau are the joints' RMS errors, computed anew in every round. Both sides pass the same low-pass.

    Attributes:
        experiment: how to simulate.

    Source: walter1997.
    """

    experiment: Experiment

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate the base parameters.

        Raises:
            InputError: too few samples, or a problem that is not the experiment's.
            GapscopeError: the simulated arm diverges at the start.
        """
        experiment = self.experiment
        experiment.check(problem)
        measured = _outputs(experiment.recordings)
        beta = experiment.start
        with _divergence(0):
            error = measured - _outputs(experiment.simulate(beta))

        def residual(x: np.ndarray, scale: np.ndarray) -> np.ndarray:
            try:
                return ((measured - _outputs(experiment.simulate(x))) / scale).ravel()
            except GapscopeError:  # so that the step is taken back
                return np.full(measured.size, np.inf)

        def slopes(x: np.ndarray, scale: np.ndarray) -> np.ndarray:
            parts = [
                _filtered(np.concatenate([by_q, by_tau], axis=1), recording)
                for recording, by_q, by_tau in experiment.tangents(x)
            ]
            scaled = np.concatenate(parts) / scale[:, None]
            return -scaled.reshape(measured.size, -1)

        for _ in range(ROUNDS):
            scale = np.maximum(rms(error), TINY)
            fit = least_squares(
                residual,
                beta,
                slopes,
                args=(scale,),
                x_scale="jac",
                ftol=SUM_SETTLED,
                max_nfev=EVALUATIONS,
            )
            beta, error = fit.x, fit.fun.reshape(error.shape) * scale
        warnings = experiment.warnings
        if fit.status <= 0:
            warnings += (f"output error {NOT_SETTLED}",)
        # that of the estimate without one stretch of time after the other
        tangents = fit.jac.reshape(*error.shape, -1)
        lengths = [len(_outputs([recording])) for recording in experiment.recordings]
        group = np.repeat(np.arange(len(lengths)), lengths)
        known = jackknife(tangents, tangents, error / scale, group)
        left = rms(error[:, problem.n_joints :])
        return _estimate(problem, beta, left, known, warnings)


def _outputs(recordings: Sequence[Recording]) -> np.ndarray:
    """Position and torque of recordings, filtered, trimmed and decimated, shape (M, 2 n)."""
    return np.concatenate(
        [_filtered(np.hstack([r.q, np.asarray(r.tau)]), r) for r in recordings]
    )


def _filtered(series: np.ndarray, recording: Recording) -> np.ndarray:
    rate = recording.rate
    edge, step = int(TRIM * rate), max(1, int(rate / (PER_CUTOFF * TORQUE_CUTOFF)))
    return low_pass(series, rate, TORQUE_CUTOFF)[edge : len(series) - edge : step]
