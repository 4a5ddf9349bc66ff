"""What a diagnosis believes of the nuisances: errors of the nominal arm and of its sensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from gapscope.diagnosis.thresholds import (
    INERTIAL_ERROR,
    INERTIAL_ERROR_FACTOR,
    INERTIAL_ERRORS,
    LINK_TO_LINK,
    NOMINAL_ERROR,
)


@dataclass(frozen=True)
class ErrorSizes:
    """Sizes that the errors of the nominal arm may have when the intervals of values are drawn.

    Not the levels of the search: these cost evidence, so that errors do not replace effects, and the smallest that
    suits the data is preferred. Intervals have to hold whatever the size is.

    Attributes:
        roots: R of the covariance R R^T of the nuisances at each size, (K, k) each.
        log_prior: of the sizes, up to a constant [nats].
        unseen: chance that errors that the data do not show have the size of the column, if those that they do show
            have the size of the row, (L, L): sizes differ from link to link.
    """

    roots: tuple[np.ndarray, ...]
    log_prior: np.ndarray
    unseen: np.ndarray


@dataclass(frozen=True)
class NuisancePrior:
    """Prior of the K nuisances, at several levels of how far the nominal arm may be off.

    Attributes:
        precision: of the nuisances at each level, (K, K).
        levels: the levels that are tried, each with its charge [nats].
        sizes: what intervals of values are drawn from.
    """

    precision: Mapping[float, np.ndarray]
    levels: Mapping[float, float]
    sizes: ErrorSizes

    def at(self, level: float) -> np.ndarray:
        """Precision of the nuisances at a level, (K, K)."""
        return self.precision[level]


def data_sheet_prior(errors: np.ndarray, others: int) -> NuisancePrior:
    """Errors of the inertials, which a level scales, and of others in units of their spread.

    The search takes relative errors of the inertials as independent; intervals take those of one body together.

    Args:
        errors: root of the covariance of inertials that are off by their own size, (10 n, 10 n).
        others: number of the other nuisances.
    """
    precision = {}
    for level in NOMINAL_ERROR:
        of_inertials = np.full(len(errors), 1.0 / level**2)
        precision[level] = np.diag(np.concatenate([of_inertials, np.ones(others)]))
    sizes = ErrorSizes(
        tuple(block_diag(size * errors, np.eye(others)) for size in INERTIAL_ERRORS),
        _log_normal(INERTIAL_ERRORS / INERTIAL_ERROR, INERTIAL_ERROR_FACTOR),
        _unseen(INERTIAL_ERRORS),
    )
    return NuisancePrior(precision, NOMINAL_ERROR, sizes)


def _log_normal(ratio: np.ndarray, factor: float) -> np.ndarray:
    """Logarithm of a density by which ratios of ``factor`` and one over it are one deviation off [nats]."""
    return np.asarray(-0.5 * (np.log(ratio) / np.log(factor)) ** 2)


def _unseen(sizes: np.ndarray) -> np.ndarray:
    """Chances of the sizes of one link's errors, by row that of another's, (L, L)."""
    density = np.exp(_log_normal(sizes / sizes[:, None], LINK_TO_LINK))
    return np.asarray(density / density.sum(axis=1, keepdims=True))
