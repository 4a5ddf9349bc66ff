"""Intervals for the torque that an identified model predicts on other trajectories, model error included."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from gapscope.arm.errors import InputError
from gapscope.ident.estimators.estimate import Estimate, Estimator
from gapscope.ident.estimators.joint_triangles import JointTriangles
from gapscope.ident.estimators.wls import WeightedLeastSquares
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.uncertainty.intervals import Uncertainty, several_groups
from gapscope.ident.uncertainty.model_error import ModelError, model_error
from gapscope.model.conditioning import TORQUE_CUTOFF


@dataclass(frozen=True)
class TorqueInterval:
    """How far the arm's torque may lie from the model's.

    Attributes:
        estimate: the model.
        parameters: how well its parameters are known.
        error: noise and model error of torque that was not fitted.
        warnings: of model error, with a remedy.
    """

    estimate: Estimate
    parameters: Uncertainty
    error: ModelError
    warnings: tuple[str, ...]

    def half_width(
        self, matrix: np.ndarray, level: float = 0.95, *, recorded: bool = False
    ) -> np.ndarray:
        """Half the width of the interval [N m], shape (N, n), about W beta.

        t sqrt(v + s^2), v = W C W^T with the parameters' covariance C, and the model error s of each joint. Student's
        t has (v + s^2)^2 / (v^2 / f + s^4 / (G - 1)) degrees of freedom (Welch and Satterthwaite), f those of C, and
        G groups: another motion's model error is one more draw beside theirs.

        Args:
            matrix: W of the other trajectory, shape (N, n, b).
            level: share of samples that the interval is to hold [1].
            recorded: of the torque as it would be recorded, noise included, instead of the torque itself.
        """
        own = ((matrix @ self.parameters.covariance) * matrix).sum(axis=2)
        systematic = self.error.systematic**2
        variance = own + systematic
        # Welch and Satterthwaite
        own_part = own**2 / max(self.parameters.freedom, 1.0)
        systematic_part = systematic**2 / max(self.error.groups - 1, 1)
        parts = np.maximum(own_part + systematic_part, 1e-300)
        freedom = np.maximum(variance**2 / parts, 1.0)
        noise = self.error.noise**2 if recorded else 0.0
        return student.ppf(0.5 + level / 2, freedom) * np.sqrt(variance + noise)


@dataclass(frozen=True)
class PredictedTorque:
    """Intervals of predicted torque on some recordings, n joints.

    Attributes:
        level: share of samples that an interval is to hold [1].
        half_width: RMS half width for the arm's torque [N m], shape (n,).
        recorded: the same for the torque as it is recorded, noise included [N m], shape (n,).
        held: share of recorded samples within the latter [1], shape (n,).
    """

    level: float
    half_width: np.ndarray
    recorded: np.ndarray
    held: np.ndarray


def predicted_torque(
    interval: TorqueInterval, problem: Problem, beta: np.ndarray, level: float = 0.95
) -> PredictedTorque:
    """Intervals on recordings that were not fitted, and how many of their samples lie within.

    Args:
        interval: of the model.
        problem: other recordings in the same base columns.
        beta: what is predicted with, shape (b,).
        level: share of samples that an interval is to hold [1].
    """
    own = interval.half_width(problem.matrix, level)
    recorded = interval.half_width(problem.matrix, level, recorded=True)
    inside = np.abs(problem.residual(beta)) <= recorded
    rms_own = np.sqrt((own**2).mean(axis=0))
    rms_recorded = np.sqrt((recorded**2).mean(axis=0))
    return PredictedTorque(
        level=level,
        half_width=rms_own,
        recorded=rms_recorded,
        held=inside.mean(axis=0),
    )


def torque_interval(
    problem: Problem,
    estimator: Estimator,
    uncertainty: Uncertainty,
    cutoff: float = TORQUE_CUTOFF,
    estimate: Estimate | None = None,
) -> TorqueInterval:
    """Intervals from torque held out: each group is predicted by the model that the others give.

    Args:
        problem: of at least two groups, or one that is cut into four.
        estimator: of the model.
        uncertainty: of its parameters.
        cutoff: of the low-pass that the torque passed [Hz].
        estimate: of the whole problem; estimated if ``None``.

    Raises:
        InputError: the other groups do not determine the parameters.
    """
    estimate = estimate or estimator.estimate(problem)
    error = model_error(problem, held_out(problem, estimator), cutoff)
    return TorqueInterval(
        estimate=estimate,
        parameters=uncertainty,
        error=error,
        warnings=error.warnings(),
    )


def held_out(problem: Problem, estimator: Estimator) -> np.ndarray:
    """Residual of each group under the estimate of the other groups [N m], shape (N, n)."""
    residual = np.empty_like(problem.torque)
    spans = several_groups(problem.group)
    if len(spans) < 2:
        raise InputError(
            "too few samples to hold any out", "record for longer", where="samples"
        )
    for span, value in zip(
        spans, _without_each(problem, spans, estimator), strict=True
    ):
        residual[span] = problem.rows(span).residual(value)
    return residual


def _without_each(
    problem: Problem, spans: Sequence[slice], estimator: Estimator
) -> Iterator[np.ndarray]:
    """Estimates without each group, (b,)."""
    if isinstance(estimator, WeightedLeastSquares):
        # the equations of a group are made a triangle once, not for each of the others again
        parts = [JointTriangles.of(problem.rows(span)) for span in spans]
        for k in range(len(spans)):
            others = JointTriangles.joined(parts[:k] + parts[k + 1 :])
            yield estimator.value(others)
        return
    for span in spans:
        kept = np.ones(len(problem.torque), dtype=bool)
        kept[span] = False
        yield estimator.estimate(problem.rows(kept)).value
