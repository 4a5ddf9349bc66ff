"""Uncertainty of any estimator: the estimate is repeated without one stretch of time after the other."""

from __future__ import annotations

import numpy as np

from gapscope.ident.estimators.estimate import Estimator
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.uncertainty.intervals import Uncertainty, equal_parts
from gapscope.model.effective_samples import group_slices

STRETCHES = 20
"""About how many stretches of time are left out, one at a time."""


def refit_jackknife(
    problem: Problem, estimator: Estimator, stretches: int = STRETCHES
) -> Uncertainty:
    """Covariance (G - 1) / G sum_k (beta_k - mean)(beta_k - mean)^T, beta_k the estimate without stretch k of G.

    It holds for estimators that are not linear in the torque, and counts that samples follow each other. What a pull
    adds as bias is the same in every beta_k, so it is not counted. It has G - 1 degrees of freedom.

    Args:
        problem: that was solved.
        estimator: that solved it.
        stretches: about G; each belongs to one group.

    Raises:
        InputError: the samples without a stretch do not determine the parameters.

    Source: kunsch1989.
    """
    values = []
    for span in _spans(problem.group, stretches):
        others = np.ones(len(problem.torque), dtype=bool)
        others[span] = False
        values.append(estimator.estimate(problem.rows(others)).value)
    found, count = np.array(values), len(values)
    change = found - found.mean(axis=0)
    covariance = (count - 1) / count * change.T @ change
    return Uncertainty(covariance, float(count - 1), len(problem.torque) // count)


def _spans(group: np.ndarray, stretches: int) -> list[slice]:
    """At least two stretches of about equal length within the groups."""
    length = len(group) / max(stretches, 2)
    out: list[slice] = []
    for rows in group_slices(group):
        size = rows.stop - rows.start
        # a single group is cut at least once, so that something is left to fit
        least = 2 if size == len(group) else 1
        out += equal_parts(rows, max(least, round(size / length)))
    return out
