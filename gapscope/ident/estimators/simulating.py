"""What the estimators that simulate have in common: weights, checks, intervals, and how an iteration ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.errors import GapscopeError, InputError
from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.estimators.experiment import Experiment, diverged
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.solvable import check_samples
from gapscope.ident.uncertainty.intervals import Uncertainty

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
