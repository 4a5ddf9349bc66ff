"""Noise made white: an autoregression per joint, taken out of torque and regressor alike."""

from __future__ import annotations

import numpy as np

from gapscope.ident.model.linear_problem import Problem
from gapscope.model.effective_samples import group_slices

ORDER = 2
"""Order of the autoregression."""


def white(problem: Problem, residual: np.ndarray) -> Problem:
    """The problem with noise of unit variance, uncorrelated in time within each group.

    e_k = (r_k - a_1 r_(k-1) - a_2 r_(k-2)) / s per joint, with a and s fitted to a residual; the first samples of a
    group, which have none before them, are only scaled, by the residual's own deviation. Equations that are zero, of a
    joint that does not count there, stay out, and what follows them begins anew. Source: ljung1999.

    Args:
        problem: its samples in the order of time.
        residual: what a model left of its torque [N m], shape (N, n).
    """
    count, n = residual.shape
    since = _since_group_began(problem.group)
    matrix, torque = problem.matrix.copy(), problem.torque.copy()
    parameters = problem.matrix.shape[2]
    free = 1 - parameters / max(residual.size, parameters + 1)
    for j in range(n):
        own = residual[:, j]
        counted = problem.matrix[:, j].any(axis=1)
        late = counted & (since >= ORDER)
        for lag in range(1, ORDER + 1):
            late &= np.roll(counted, lag)
        # nothing to learn a correlation from
        if late.sum() <= ORDER:
            continue
        past = np.stack([np.roll(own, lag) for lag in range(1, ORDER + 1)], axis=1)
        coefficients = np.linalg.lstsq(past[late], own[late], rcond=None)[0]
        innovation = own[late] - past[late] @ coefficients
        # the first samples of a group have no past: they are only scaled
        deviation = np.full(count, np.sqrt(np.mean(own[counted] ** 2) / free))
        deviation[late] = np.sqrt(np.mean(innovation**2) / free)
        scale = np.maximum(deviation, 1e-12)[:, None]
        for lag, coefficient in enumerate(coefficients, 1):
            earlier_rows = np.roll(problem.matrix[:, j], lag, axis=0)
            earlier_torque = np.roll(problem.torque[:, j], lag)
            matrix[late, j] -= coefficient * earlier_rows[late]
            torque[late, j] -= coefficient * earlier_torque[late]
        matrix[:, j] /= scale
        torque[:, j] /= scale[:, 0]
    return Problem(matrix, torque, problem.names, problem.group, problem.interval)


def _since_group_began(group: np.ndarray) -> np.ndarray:
    """Samples of the same group before each sample, shape (N,)."""
    since = np.arange(len(group))
    for rows in group_slices(group):
        since[rows] -= rows.start
    return since
