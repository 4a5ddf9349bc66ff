"""What a diagnosis believes of the nuisances: errors of the nominal arm, of its sensors, and of a reference."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from gapscope.arm.motions.motion import Motion
from gapscope.diagnosis.thresholds import (
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
class NuisancePrior:
    """Prior of the K nuisances, at several levels of how far the nominal arm may be off.

    Attributes:
        precision: of the nuisances at each level, (K, K).
        levels: the levels that are tried, each with its charge [nats].
        unit: relative error of the inertials at level 1 [1].
    """

    precision: Mapping[float, np.ndarray]
    levels: Mapping[float, float]
    unit: float

    def at(self, level: float) -> np.ndarray:
        """Precision of the nuisances at a level, (K, K)."""
        return self.precision[level]


LEAST_EIGENVALUE = 1e-11
"""Least eigenvalue of a covariance of unit diagonal that double precision resolves [1]."""


def data_sheet_prior(inertials: int, others: int) -> NuisancePrior:
    """Independent relative errors of the inertials, which a level scales, and of others in units of their spread."""
    precision = {}
    for level in NOMINAL_ERROR:
        of_inertials = np.full(inertials, 1.0 / level**2)
        precision[level] = np.diag(np.concatenate([of_inertials, np.ones(others)]))
    return NuisancePrior(precision, NOMINAL_ERROR, 1.0)


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
    return NuisancePrior(precision, REFERENCE_ERROR, 0.003)


def inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a covariance or a precision, scaled to a diagonal of ones first; positive definite in any case.

    Eigenvalues that rounding has made less than ``LEAST_EIGENVALUE`` count as that.
    """
    unit = 1.0 / np.sqrt(np.diag(matrix))
    scaled = matrix * unit[:, None] * unit
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    kept = np.maximum(values, LEAST_EIGENVALUE)
    inverted = (vectors / kept) @ vectors.T
    return np.asarray(inverted * unit[:, None] * unit)
