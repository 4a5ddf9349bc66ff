"""The result of an estimator, and its interface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gapscope.ident.model.linear_problem import Problem


@dataclass(frozen=True)
class Estimate:
    """Estimated parameters.

    Attributes:
        names: of the parameters, shape (b,).
        value: shape (b,).
        covariance: as the estimator itself states it, shape (b, b).
        residual: RMS residual per joint [N m], shape (n,).
        warnings: what makes the result doubtful, each a sentence with a remedy.
        freedom: degrees of freedom of the covariance; ``None`` for those of white noise.
    """

    names: Sequence[str]
    value: np.ndarray
    covariance: np.ndarray
    residual: np.ndarray
    warnings: tuple[str, ...] = ()
    freedom: float | None = None

    @property
    def deviation(self) -> np.ndarray:
        """Standard errors, shape (b,)."""
        return np.sqrt(np.diag(self.covariance).clip(0.0))


class Estimator(Protocol):
    """An estimator of the parameters of a linear problem."""

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate the parameters; raises ``InputError`` if the samples cannot determine them."""
