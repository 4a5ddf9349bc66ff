"""Samples gathered into stretches of time, each reduced to as many equations as there are parameters."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gapscope.ident.model.linear_problem import Problem
from gapscope.model.effective_samples import group_slices

SHORTEST = 0.25
"""Least length of a stretch [s]."""
MOST = 200
"""Stretches at most, which bounds time and memory of a filter over them."""


@dataclass(frozen=True)
class Stretches:
    """A problem as K stretches of samples that follow each other within a group.

    Attributes:
        rows: the samples of each stretch, K slices.
        reduced: R_k beta = z_k + noise of unit variance, from the QR of the stretch's W over the noise; matrix of shape
            (K, b, b), torque (K, b). What is left out does not depend on beta.
        ends: time at the last sample of each, counted over all groups without the gaps between them [s], shape (K,).
    """

    rows: tuple[slice, ...]
    reduced: Problem
    ends: np.ndarray

    @classmethod
    def of(cls, problem: Problem, noise: np.ndarray) -> Stretches:
        """Stretches of at least ``SHORTEST`` seconds, about ``MOST`` at most.

        Args:
            problem: N samples in the order of time.
            noise: standard deviation of the torque's noise [N m], shape (n,).
        """
        rows = _cut(problem)
        b = problem.matrix.shape[2]
        matrix, torque = np.zeros((len(rows), b, b)), np.zeros((len(rows), b))
        for k, own in enumerate(rows):
            columns = problem.matrix[own] / noise[:, None]
            right = problem.torque[own] / noise
            both = np.concatenate([columns, right[..., None]], axis=2)
            triangle = np.asarray(np.linalg.qr(both.reshape(-1, b + 1), mode="r"))
            # the last row, if there is one, holds what no beta explains
            upper = triangle[:b]
            matrix[k, : len(upper)] = upper[:, :b]
            torque[k, : len(upper)] = upper[:, b]
        ends = problem.interval * np.array([own.stop - 1 for own in rows])
        groups = np.array([problem.group[own.start] for own in rows])
        length = problem.interval * (rows[0].stop - rows[0].start)
        reduced = Problem(matrix, torque, problem.names, groups, length)
        return cls(rows, reduced, ends)

    @property
    def length(self) -> float:
        """Length of a stretch [s]."""
        return self.reduced.interval


def _cut(problem: Problem) -> tuple[slice, ...]:
    """Slices of about equal length within groups."""
    least = SHORTEST / problem.interval
    samples = max(1, round(max(least, len(problem.torque) / MOST)))
    rows = []
    for group in group_slices(problem.group):
        count = max(1, (group.stop - group.start) // samples)
        edges = np.linspace(group.start, group.stop, count + 1).astype(int)
        rows += [slice(start, stop) for start, stop in pairwise(edges.tolist())]
    return tuple(rows)
