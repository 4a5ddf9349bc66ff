"""The linear problem of identification, tau = W beta + noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Problem:
    """Tau = W beta + noise, N samples of n joints, b parameters.

    Attributes:
        matrix: W, shape (N, n, b); base columns, so that it has full rank, unless said otherwise.
        torque: tau [N m], shape (N, n).
        names: of the parameters, shape (b,).
        group: which recording (or stretch of one) a sample belongs to, shape (N,), integers that do not fall.
        interval: time between samples [s].
    """

    matrix: np.ndarray
    torque: np.ndarray
    names: Sequence[str]
    group: np.ndarray
    interval: float

    @property
    def n_joints(self) -> int:
        """Number n of joints."""
        return self.torque.shape[1]

    def stacked(self) -> tuple[np.ndarray, np.ndarray]:
        """W of shape (N n, b) and tau of shape (N n,)."""
        return self.matrix.reshape(-1, self.matrix.shape[2]), self.torque.ravel()

    def residual(self, beta: np.ndarray) -> np.ndarray:
        """Tau - W beta [N m], shape (N, n)."""
        return self.torque - self.matrix @ beta

    def rows(self, chosen: np.ndarray | slice) -> Problem:
        """The problem of some samples only."""
        return Problem(
            self.matrix[chosen],
            self.torque[chosen],
            self.names,
            self.group[chosen],
            self.interval,
        )
