"""What a diagnosis believes of the nuisances: errors of the nominal arm, of its sensors, and of a reference."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from gapscope.arm.motions.motion import Motion
from gapscope.diagnosis.thresholds import (
    INERTIAL_ERROR,
    INERTIAL_ERROR_FACTOR,
    INERTIAL_ERRORS,
    LINK_TO_LINK,
    NOMINAL_ERROR,
    REFERENCE_ERROR,
    REFERENCE_GAIN,
)


@dataclass(frozen=True)
class ReferenceErrors:
    """What a reference leaves open of an arm with n joints: errors of its inertials, then of q joint parameters.

    Attributes:
        covariance: of the errors of what was identified, (10 n + q, 10 n + q), in their units.
        day_to_day: variances of what differs from day to day beside that, (10 n + q,).
        columns: derivatives of the torque by the joint parameters, (N, n, q), on a motion of N samples: friction as
            it was identified, rotors, offsets.
        rest: RMS that the arm identified leaves on data that it was not fitted to [N m], (n,).
        samples: independent samples of it, (n,).
    """

    covariance: np.ndarray
    day_to_day: np.ndarray
    columns: Callable[[Motion], np.ndarray]
    rest: np.ndarray
    samples: np.ndarray


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
        unit: relative error of the inertials at level 1 [1].
        sizes: what intervals of values are drawn from.
    """

    precision: Mapping[float, np.ndarray]
    levels: Mapping[float, float]
    unit: float
    sizes: ErrorSizes

    def at(self, level: float) -> np.ndarray:
        """Precision of the nuisances at a level, (K, K)."""
        return self.precision[level]


LEAST_EIGENVALUE = 1e-11
"""Least eigenvalue of a covariance of unit diagonal that double precision resolves [1]."""


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
    return NuisancePrior(precision, NOMINAL_ERROR, 1.0, sizes)


def _log_normal(ratio: np.ndarray, factor: float) -> np.ndarray:
    """Logarithm of a density by which ratios of ``factor`` and one over it are one deviation off [nats]."""
    return np.asarray(-0.5 * (np.log(ratio) / np.log(factor)) ** 2)


def _unseen(sizes: np.ndarray) -> np.ndarray:
    """Chances of the sizes of one link's errors, by row that of another's, (L, L)."""
    density = np.exp(_log_normal(sizes / sizes[:, None], LINK_TO_LINK))
    return np.asarray(density / density.sum(axis=1, keepdims=True))


def reference_prior(
    errors: ReferenceErrors, units: np.ndarray, joints: int
) -> NuisancePrior:
    """Errors that a reference leaves open, and of the gain by which each joint's torque was and is recorded.

    A level scales the errors of what was identified; what differs from day to day has its own size.

    Args:
        errors: of the inertials and the joints' parameters.
        units: of the inertials' columns, (10 n,).
        joints: n.
    """
    own = len(errors.covariance) - len(units)
    scale = np.concatenate([units, np.ones(own)])
    # a link without mass has no error
    known = scale > 0
    per_unit = np.divide(1.0, scale, out=np.zeros_like(scale), where=known)
    identified = errors.covariance * np.outer(per_unit, per_unit)
    identified[~known, ~known] = 1e-12
    day_to_day = np.diag(errors.day_to_day * per_unit**2)
    size, precision = len(scale), {}
    for level in REFERENCE_ERROR:
        whole = np.eye(size + joints) / REFERENCE_GAIN**2
        whole[:size, :size] = inverse(level**2 * identified + day_to_day)
        precision[level] = whole
    sizes = ErrorSizes(
        tuple(root_of_inverse(precision[level]) for level in REFERENCE_ERROR),
        -np.array(list(REFERENCE_ERROR.values())),
        np.eye(len(REFERENCE_ERROR)),
    )
    return NuisancePrior(precision, REFERENCE_ERROR, 0.003, sizes)


def inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a covariance or a precision, scaled to a diagonal of ones first; positive definite in any case.

    Eigenvalues that rounding has made less than ``LEAST_EIGENVALUE`` count as that.
    """
    root = root_of_inverse(matrix)
    return np.asarray(root @ root.T)


def root_of_inverse(matrix: np.ndarray) -> np.ndarray:
    """R with R R^T the inverse of a covariance or a precision, as ``inverse`` takes it; of its shape."""
    unit = 1.0 / np.sqrt(np.diag(matrix))
    scaled = matrix * unit[:, None] * unit
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    kept = np.maximum(values, LEAST_EIGENVALUE)
    return np.asarray(unit[:, None] * vectors / np.sqrt(kept))
