"""Partial update: from a prior, such as the simulated arm's, only the parameters move that the data determine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.estimators.linear_estimator import (
    Factor,
    finished,
    joint_noise,
    whitened,
)
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.solvable import check_samples, unit_warnings
from gapscope.model.effective_samples import variance_inflation

RELATIVE = 0.2
"""How far an inertial parameter of a simulated arm is believed to be off, relative to its value [1]."""
FRICTION_RELATIVE = 1.0
"""The same of friction, which differs from arm to arm [1]."""
SLIGHT = 0.05
"""And a parameter near 0 by what gives this share of the torque's RMS [1]."""
START_NOISE = 0.01
"""Noise taken at first beside what a free fit leaves, over the torque's RMS: few samples leave a free fit nothing."""
ROUNDS = 20
"""Most rounds of estimating noise and parameters in turn."""


@dataclass(frozen=True)
class PartialUpdate:
    """The most probable beta under a prior N(beta_0, diag(spread^2)), with the parameters held that data hardly move.

    A parameter is influential if the data determine it at least as well as the prior does: its prior variance is at
    least ``influence`` times the variance that data and prior together leave. The others are held at beta_0 and the
    rest is estimated anew. Noise per joint is that of the residual; its autocorrelation rho_k inflates the variance by
    1 + 2 sum_k rho_k. The covariance is the posterior one; a parameter that is
    held keeps its prior variance.

    Attributes:
        prior: beta_0, shape (b,).
        spread: standard deviation that the prior is believed to have, shape (b,); by default ``RELATIVE`` of
            |beta_0| (friction and offsets: ``FRICTION_RELATIVE``), and nowhere less than what gives ``SLIGHT`` of the
            torque.
        influence: least ratio of variances of a parameter that moves [1].

    Source: pham1991.
    """

    prior: np.ndarray
    spread: np.ndarray | None = None
    influence: float = 2.0

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate; raises ``InputError`` if samples are not finite, the arm rests, or the prior does not fit."""
        check_samples(problem, full_rank=False)
        prior = np.asarray(self.prior, dtype=float)
        spread = (
            default_spread(problem, prior)
            if self.spread is None
            else np.asarray(self.spread, dtype=float)
        )
        b = problem.matrix.shape[2]
        if prior.shape != (b,) or spread.shape != (b,) or not (spread > 0).all():
            raise InputError(
                f"expected {b} values, one per parameter, and spreads above 0",
                where="prior",
            )
        noise = np.hypot(
            joint_noise(problem, _free(problem, prior, spread)),
            START_NOISE * np.sqrt((problem.torque**2).mean(axis=0).max()),
        )
        beta, covariance, moved = self._updated(problem, prior, spread, noise)
        for _ in range(ROUNDS):
            before = beta
            noise = joint_noise(problem, beta) * np.sqrt(
                variance_inflation(problem.residual(beta), problem.group)
            )
            beta, covariance, moved = self._updated(problem, prior, spread, noise)
            if np.abs((beta - before) / spread).max() < 1e-6:
                break
        warnings = unit_warnings(problem, prior)
        if not moved.any():
            warnings += (
                "the data move no parameter: too little motion, or a prior that is already as good",
            )
        return finished(problem, beta, covariance, warnings)

    def moved(self, estimate: Estimate) -> np.ndarray:
        """Which parameters an estimate of this prior moved, shape (b,)."""
        return estimate.value != np.asarray(self.prior, dtype=float)

    def _updated(
        self, problem: Problem, prior: np.ndarray, spread: np.ndarray, noise: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Posterior mean and covariance under a noise per joint [N m], shape (n,), and which parameters moved."""
        factor = Factor.of(*whitened(problem, noise))
        gap = factor.rotated - factor.triangle @ prior
        # in units of the prior's deviation the prior precision is the identity
        triangle = factor.triangle * spread
        information = triangle.T @ triangle
        posterior = np.linalg.inv(information + np.eye(len(prior)))
        moved = np.diag(posterior) * self.influence <= 1.0
        step, covariance = np.zeros(len(prior)), np.diag(spread**2)
        if moved.any():
            # parameters that the data hardly determine stay at the prior, exactly
            block = np.ix_(moved, moved)
            own = np.linalg.inv(information[block] + np.eye(int(moved.sum())))
            step[moved] = own @ (triangle[:, moved].T @ gap)
            units = spread[moved]
            covariance[block] = own * np.outer(units, units)
        return prior + spread * step, covariance, moved


def _free(problem: Problem, prior: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """The least-squares estimate, the nearest to the prior if there are many, shape (b,)."""
    matrix, torque = problem.stacked()
    factor = Factor.of(matrix * spread, torque - matrix @ prior)
    step = np.linalg.lstsq(factor.triangle, factor.rotated, rcond=1e-9)[0]
    return prior + spread * step


def default_spread(problem: Problem, prior: np.ndarray) -> np.ndarray:
    """Prior standard deviation of a simulated arm's parameters, shape (b,)."""
    relative = np.where(_is_friction(problem.names), FRICTION_RELATIVE, RELATIVE)
    column_rms = np.sqrt((problem.matrix**2).mean(axis=(0, 1)))
    torque_rms = np.sqrt((problem.torque**2).mean())
    least_rms = 1e-6 * max(float(column_rms.max()), 1e-300)
    # a parameter that is zero in the prior may still add this share of the torque
    slight = SLIGHT * torque_rms / np.maximum(column_rms, least_rms)
    return np.maximum(relative * np.abs(prior), slight)


def _is_friction(names: Sequence[str]) -> np.ndarray:
    return np.array([name[0] in "bco" and name[1:].isdigit() for name in names])
