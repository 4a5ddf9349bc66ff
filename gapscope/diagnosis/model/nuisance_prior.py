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
        covariance: of the errors on the day of the case, (10 n + q, 10 n + q), in their units.
        columns: derivatives of the torque by the joint parameters, (N, n, q), on a motion of N samples: friction as
            it was identified, rotors, offsets.
        rest: RMS that the arm identified leaves on data that it was not fitted to [N m], (n,).
        samples: independent samples of it, (n,).
    """

    covariance: np.ndarray
    columns: Callable[[Motion], np.ndarray]
    rest: np.ndarray
    samples: np.ndarray


@dataclass(frozen=True)
class NuisancePrior:
    """Prior of the K nuisances, at several levels of how far the nominal arm may be off.

    Attributes:
        precision: of the nuisances at level 1, (K, K).
        inertials: number of those that a level scales; the others stay.
        levels: the levels that are tried, each with its charge [nats].
        unit: relative error of the inertials at level 1 [1].
    """

    precision: np.ndarray
    inertials: int
    levels: Mapping[float, float]
    unit: float

    def at(self, level: float) -> np.ndarray:
        """Precision of the nuisances at a level, (K, K)."""
        scale = np.ones(len(self.precision))
        scale[: self.inertials] = 1.0 / level
        return self.precision * np.outer(scale, scale)


LEAST_EIGENVALUE = 1e-11
"""Least eigenvalue of a covariance of unit diagonal that double precision resolves [1]."""


def data_sheet_prior(inertials: int, others: int) -> NuisancePrior:
    """Independent relative errors of the inertials, and of others in units of their spread."""
    precision = np.eye(inertials + others)
    return NuisancePrior(precision, inertials, NOMINAL_ERROR, 1.0)


def reference_prior(
    errors: ReferenceErrors, units: np.ndarray, joints: int
) -> NuisancePrior:
    """Errors that a reference leaves open, and of the gain by which each joint's torque was and is recorded.

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
    covariance = errors.covariance * np.outer(per_unit, per_unit)
    covariance[~known, ~known] = 1e-12
    precision = inverse(covariance)
    size = len(scale)
    whole = np.zeros((size + joints, size + joints))
    whole[:size, :size] = precision
    whole[size:, size:] = np.eye(joints) / REFERENCE_GAIN**2
    return NuisancePrior(whole, size, REFERENCE_ERROR, 0.003)


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
