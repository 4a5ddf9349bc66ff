"""Ridge regression, its strength chosen by held-out motions, the L-curve or generalised cross-validation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.estimators.linear_estimator import (
    Factor,
    column_norms,
    finished,
    held_out_squares,
    strongest_as_good,
)
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.solvable import check_samples

STRENGTHS = np.logspace(-12, 1, 131)
"""Strengths that are tried."""
WORSE = 1.02
"""The L-curve of a well-conditioned problem has no corner of its own: a strength that leaves more than this times the
least squared residual is not taken [1]."""


@dataclass(frozen=True)
class Ridge:
    """Minimises |tau - W beta|^2 + lambda |D (beta - beta_0)|^2, D the norms of W's columns.

    With columns of unit norm lambda has no unit: it is compared with the squared singular values, of which none
    exceeds b. The covariance is that of the noise alone; what the pull adds as bias is not in it.

    Attributes:
        choice: ``motion`` (the strongest that predicts motions as well as any that were not fitted), ``gcv`` (least
            |residual|^2 / (M - effective parameters)^2), ``l_curve`` (the sharpest corner of log |residual| against log
            |D (beta - beta_0)|), or lambda itself.
        prior: beta_0, shape (b,); zero if ``None``.

    Source: hansen1992, golub1979.
    """

    choice: str | float = "gcv"
    prior: np.ndarray | None = None

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate; raises ``InputError`` if the samples are not finite or the arm rests."""
        check_samples(problem, full_rank=False)
        matrix, torque = problem.stacked()
        b = matrix.shape[1]
        prior = np.zeros(b) if self.prior is None else self.prior
        prior = np.asarray(prior, dtype=float)
        norms = column_norms(matrix)
        factor = Factor.of(matrix / norms, torque - matrix @ prior)
        left, values, right = np.linalg.svd(factor.triangle)
        part = left.T @ factor.rotated
        # along each singular direction the prior weighs as much as the data at values**2 = strength
        if self.choice == "motion":
            by_motion = held_out_squares(
                problem, prior, lambda own: 1 / (own + STRENGTHS[:, None])
            )
            strength = float(STRENGTHS[strongest_as_good(by_motion)])
        else:
            strength = self._strength(values, part, factor)
        gain = values / np.maximum(values**2 + strength, 1e-300)
        beta = prior + right.T @ (gain * part) / norms
        # share of each direction that the data decide
        decided = values * gain
        effective = float(decided.sum())
        unexplained = (1 - decided) * part
        squares = factor.rest + float(unexplained @ unexplained)
        noise = squares / max(factor.rows - effective, 1.0)
        half = right.T * gain / norms[:, None]
        warnings: tuple[str, ...] = ()
        if effective <= 0.9 * b:
            warnings = (
                f"the pull holds {b - effective:.1f} of {b} directions; their stated deviation leaves "
                "out the bias that this adds; record a trajectory that excites them",
            )
        return finished(problem, beta, noise * half @ half.T, warnings)

    def _strength(self, values: np.ndarray, part: np.ndarray, factor: Factor) -> float:
        """The strength that was given, or chosen among ``STRENGTHS``."""
        if not isinstance(self.choice, str):
            return float(self.choice)
        # rows: strengths; columns: directions
        pulled = STRENGTHS[:, None] / (values**2 + STRENGTHS[:, None])
        residual = ((pulled * part) ** 2).sum(axis=1) + factor.rest
        if self.choice == "gcv":
            free = factor.rows - len(values) + pulled.sum(axis=1)
            score = residual / np.maximum(free, 1e-9) ** 2
            return float(STRENGTHS[np.argmin(score)])
        solution = (1 - pulled) * part / np.maximum(values, 1e-300)
        size = (solution**2).sum(axis=1)
        log_residual = 0.5 * np.log(np.maximum(residual, 1e-300))
        corner = _corner(log_residual, 0.5 * np.log(size + 1e-300))
        # a corner at which the fit is much worse is none
        last_good = int((residual <= WORSE * residual[0]).sum()) - 1
        return float(STRENGTHS[min(corner, last_good)])


def _corner(x: np.ndarray, y: np.ndarray) -> int:
    """Place of the largest curvature of a curve of evenly spaced strengths."""
    dx, dy = np.gradient(x), np.gradient(y)
    cross = dx * np.gradient(dy) - dy * np.gradient(dx)
    speed = (dx**2 + dy**2) ** 1.5
    curvature = cross / np.maximum(speed, 1e-12)
    # the differences at the ends are one-sided
    return int(np.argmax(curvature[2:-2]) + 2)
