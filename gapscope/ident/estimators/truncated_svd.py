"""Truncated singular value decomposition: directions that the samples hardly excite stay at the prior."""

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


@dataclass(frozen=True)
class TruncatedSvd:
    """beta = beta_0 + D^-1 sum_{i <= k} v_i u_i^T (tau - W beta_0) / s_i, with W D^-1 = U S V^T of unit columns.

    Attributes:
        condition: directions with s_1 / s_i above this are dropped; ``None`` chooses k by generalised
            cross-validation, least |residual|^2 / (M - k)^2.
        prior: beta_0, shape (b,); zero if ``None``.
        count: k itself, or ``motion``: the least that predicts motions as well as any that were not fitted.

    Source: hansen1987.
    """

    condition: float | None = None
    prior: np.ndarray | None = None
    count: int | str | None = None

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
        # squared residual with the first k directions, for k = 0 to b
        dropped_squares = np.append(np.cumsum(part[::-1] ** 2)[::-1], 0.0)
        squares = factor.rest + dropped_squares
        # weak directions stay at the prior
        if self.count == "motion":
            rank = _rank_by_motion(problem, prior)
        elif isinstance(self.count, int):
            rank = min(self.count, b)
        else:
            rank = self._rank(values, squares, factor.rows)
        half = right[:rank].T / values[:rank] / norms[:, None]
        beta = prior + half @ part[:rank]
        noise = squares[rank] / max(factor.rows - rank, 1)
        warnings: tuple[str, ...] = ()
        if rank < b:
            warnings = (
                f"{b - rank} of {b} directions were dropped and stay at the prior; their deviation is not stated; "
                "record a trajectory that excites them",
            )
        return finished(problem, beta, noise * half @ half.T, warnings)

    def _rank(self, values: np.ndarray, squares: np.ndarray, rows: int) -> int:
        """Number of directions kept; ``squares[k]`` is the squared residual with k of them."""
        regular = int((values > 1e-12 * values[0]).sum())
        if self.condition is not None:
            well_conditioned = int((values * self.condition >= values[0]).sum())
            return min(regular, well_conditioned)
        count = np.arange(1, regular + 1)
        # generalised cross-validation
        score = squares[count] / np.maximum(rows - count, 1e-3) ** 2
        return int(count[np.argmin(score)])


def _rank_by_motion(problem: Problem, prior: np.ndarray) -> int:
    """The least number of directions, 0 to b, that predicts motions as well as any that were not fitted."""
    b = problem.matrix.shape[2]
    # squared singular values ascend: the last k are kept
    kept = np.arange(b)[::-1] < np.arange(b, -1, -1)[:, None]

    def filters(values: np.ndarray) -> np.ndarray:
        regular = kept & (values > 1e-13 * values[-1])
        return np.where(regular, 1 / np.maximum(values, 1e-300), 0.0)

    return b - strongest_as_good(held_out_squares(problem, prior, filters))
