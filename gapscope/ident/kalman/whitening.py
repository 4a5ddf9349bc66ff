"""Noise made white: an autoregression per joint, taken out of torque and regressor alike."""

from __future__ import annotations

import numpy as np

from gapscope.ident.model.linear_problem import Problem

ORDER = 2
"""Order of the autoregression."""


def white(problem: Problem, residual: np.ndarray) -> Problem:
    """The problem with noise of unit variance, uncorrelated in time within each group.

    e_k = (r_k - a_1 r_(k-1) - a_2 r_(k-2)) / s per joint, with a and s fitted to a residual; the first samples of a
    group, which have none before them, are only scaled, by the residual's own deviation. Source: ljung1999.

    Args:
        problem: its samples in the order of time.
        residual: what a model left of its torque [N m], shape (N, n).
    """
    count, n = residual.shape
    first = np.concatenate([[0], np.flatnonzero(np.diff(problem.group)) + 1])
    since = np.arange(count) - np.repeat(first, np.diff([*first, count]))
    late = since >= ORDER
    matrix, torque = problem.matrix.copy(), problem.torque.copy()
    free = 1 - problem.matrix.shape[2] / max(residual.size, problem.matrix.shape[2] + 1)
    for j in range(n):
        past = np.stack(
            [np.roll(residual[:, j], lag) for lag in range(1, ORDER + 1)], axis=1
        )
        a = np.linalg.lstsq(past[late], residual[late, j], rcond=None)[0]
        left = np.sqrt(np.mean((residual[late, j] - past[late] @ a) ** 2) / free)
        whole = np.sqrt(np.mean(residual[:, j] ** 2) / free)
        scale = np.maximum(np.where(late, left, whole), 1e-12)
        for series, own in (
            (matrix[:, j], problem.matrix[:, j]),
            (torque[:, j : j + 1], problem.torque[:, j : j + 1]),
        ):
            for lag in range(1, ORDER + 1):
                series[late] -= a[lag - 1] * np.roll(own, lag, axis=0)[late]
            series /= scale[:, None]
    return Problem(matrix, torque, problem.names, problem.group, problem.interval)
