"""The fit to a reference: the same arm, known to be healthy and without load, identified on its recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.recording import Recording
from gapscope.diagnosis.assessment.baseline import back_in_time
from gapscope.diagnosis.reference.reference_rows import ReferenceRows, stack
from gapscope.diagnosis.thresholds import (
    LEAST_REFERENCE_SKEW,
    MOST_REFERENCE_SKEW,
    VENDOR_INERTIALS,
)
from gapscope.ident.fitted_parameters import (
    FittedParameters,
    IdentificationSettings,
    fit_parameters,
)
from gapscope.ident.identification import Identification, examine_fit
from gapscope.ident.model.rank import orthonormal_columns
from gapscope.ident.signals.conditioning import position_cutoff
from gapscope.ident.signals.effective_samples import independent_samples
from gapscope.model.torque_gap import torque_scale

REWEIGHTINGS = 3
"""Times that the joints are weighed by the residual on held-out stretches."""
RANK_TOLERANCE = 1e-4
"""Singular values below this share of the largest belong to no direction of the model [1]."""


@dataclass(frozen=True)
class ReferenceFit:
    """The fit to a reference, n joints, p parameters x of the model tau = W x.

    Attributes:
        case: the reference, its torque put back by the skew.
        result: the identification on all its recordings.
        precision: inverse covariance of x, what the recordings and the vendor's URDF say together, (p, p).
        rest: RMS left on stretches of the reference predicted from the others [N m], (n,).
        samples: independent samples of it, (n,).
        scale: normalisation of the torque gap on the reference [N m], (n,).
        skew: by which torque is ahead of the motion [s].
        torque_ratio: torque of the identified bodies over that of the vendor's [1].
    """

    case: Case
    result: Identification
    precision: np.ndarray
    rest: np.ndarray
    samples: np.ndarray
    scale: np.ndarray
    skew: float
    torque_ratio: float


def fit_reference(
    reference: Case, progress: Callable[[str], None] = lambda message: None
) -> ReferenceFit:
    """Identify an arm on all recordings of a reference with a torque.

    Raises:
        InputError: no torque, no motion, too short, torque in another unit; says what to do.
    """
    with_torque = tuple(
        r for r in (*reference.recordings, *reference.judged) if r.tau is not None
    )
    # without any torque the identification refuses the recordings, and says so
    recordings = with_torque or reference.recordings
    reference = replace(reference, recordings=recordings, judged=recordings[-1:])
    settings = IdentificationSettings(plain=True)
    fitted = fit_parameters(reference, settings, progress)
    rows = _rows(fitted, with_torque)
    skew = _skew(rows, fitted.physical.value)
    # a skew looks like damping and armature: fit once more without it
    if abs(skew) > LEAST_REFERENCE_SKEW:
        reference = back_in_time(reference, skew)
        fitted = fit_parameters(reference, settings, progress)
        rows = _rows(fitted, reference.recordings)
    result = examine_fit(fitted, progress)
    nominal = result.columns.nominal(result.choice.law)
    prior = vendor_precision(rows, result.columns.scale(result.choice.law))
    held_out_rms = _held_out_rms(rows, nominal, prior)
    residual = rows.torque - rows.matrix @ result.physical.value
    # neighbours resemble each other: few rows of a smooth residual are independent
    samples = independent_samples(residual)
    return ReferenceFit(
        reference,
        result,
        _precision(rows, samples / len(residual), held_out_rms, prior),
        held_out_rms,
        samples,
        torque_scale(rows.torque),
        skew,
        _torque_ratio(rows, result, nominal),
    )


def _rows(fitted: FittedParameters, recordings: tuple[Recording, ...]) -> ReferenceRows:
    """Rows of recordings with the columns of the identified model."""
    cutoff = position_cutoff(recordings)
    return stack(fitted.columns, fitted.choice.law, recordings, cutoff)


def _precision(
    rows: ReferenceRows,
    independent_share: np.ndarray,
    held_out_rms: np.ndarray,
    prior: np.ndarray,
) -> np.ndarray:
    """Precision of x, (p, p): of the independent samples with the held-out error of each joint, and of the prior."""
    weight = independent_share / np.maximum(held_out_rms, 1e-9) ** 2
    return _weighted_gram(rows.matrix, weight) + np.diag(prior)


def _weighted_gram(matrix: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Sum over rows and joints of w_j W_j^T W_j, (p, p), of W, (M, n, p), and w, (n,)."""
    gram = np.einsum("mjp,j,mjq->pq", matrix, weight, matrix, optimize=True)
    return np.asarray(gram)


def _torque_ratio(
    rows: ReferenceRows, result: Identification, nominal: np.ndarray
) -> float:
    """Torque of the identified bodies over that of the vendor's, by least squares [1]."""
    links = result.columns.links
    inertial = rows.matrix[:, :, :links]
    identified = inertial @ result.physical.value[:links]
    vendor = inertial @ nominal[:links]
    power = max(float((vendor**2).sum()), 1e-12)
    return float((identified * vendor).sum() / power)


def vendor_precision(rows: ReferenceRows, scale: np.ndarray) -> np.ndarray:
    """Diagonal of the prior precision of x, (p,).

    Inertials within ``VENDOR_INERTIALS`` of the URDF; for all else, of which a data sheet need not know, as much
    as makes twice the torque's deviation.
    """
    size = np.sqrt((rows.matrix**2).mean(axis=0))
    deviation = torque_scale(rows.torque)[:, None]
    wide = 2.0 / np.maximum((size / deviation).max(axis=0), 1e-9)
    known = np.isfinite(scale)
    std = np.where(known, VENDOR_INERTIALS * np.where(known, scale, 1.0), wide)
    return std**-2.0


def _held_out_rms(
    rows: ReferenceRows, nominal: np.ndarray, prior: np.ndarray
) -> np.ndarray:
    """RMS left on each stretch when it is predicted from all others [N m], (n,)."""
    variance = rows.torque.var(axis=0)
    for _ in range(REWEIGHTINGS):
        weight = 1.0 / np.maximum(variance, 1e-12)
        grams, rights = [], []
        for stretch in rows.stretches:
            matrix = rows.matrix[stretch]
            gap = rows.torque[stretch] - matrix @ nominal
            grams.append(_weighted_gram(matrix, weight))
            right = np.einsum("mjp,j,mj->p", matrix, weight, gap)
            rights.append(right)
        all_grams, all_rights = sum(grams), sum(rights)
        squares = np.zeros_like(variance)
        for stretch, gram, right in zip(rows.stretches, grams, rights, strict=True):
            normal = all_grams - gram + np.diag(prior)
            x = nominal + _solved(normal, all_rights - right)
            error = rows.torque[stretch] - rows.matrix[stretch] @ x
            squares += (error**2).sum(axis=0)
        variance = squares / len(rows.torque)
    return np.asarray(np.sqrt(variance))


def _solved(normal: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution of normal equations, scaled to a diagonal of ones first."""
    unit = 1.0 / np.sqrt(np.diag(normal))
    scaled = normal * unit[:, None] * unit
    return np.asarray(unit * np.linalg.solve(scaled, unit * right))


def _skew(rows: ReferenceRows, x: np.ndarray) -> float:
    """By how much torque is ahead of the motion [s]: least squares of the residual on the torque's rate and W."""
    residual = rows.torque - rows.matrix @ x
    noise = np.maximum(residual.std(axis=0), 1e-9)
    columns = (rows.matrix / noise[:, None]).reshape(-1, rows.matrix.shape[2])
    basis = orthonormal_columns(columns, RANK_TOLERANCE)
    rate, target = (rows.rate / noise).reshape(-1), (residual / noise).reshape(-1)
    # what W cannot make of the torque's rate shows the skew
    rate = rate - basis @ (basis.T @ rate)
    power = max(float(rate @ rate), 1e-12 * residual.shape[1])
    skew = float(rate @ target / power)
    return float(np.clip(skew, -MOST_REFERENCE_SKEW, MOST_REFERENCE_SKEW))
