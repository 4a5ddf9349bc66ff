"""The gap that a selection leaves on held-out data, beside the floor of a healthy arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.assessment.excess_residual import (
    ExcessResidual,
    elementwise_max,
    excess_residual,
    excess_residual_set_aside,
)
from gapscope.diagnosis.assessment.held_out_prediction import HeldOutPredictor
from gapscope.diagnosis.gap.noise_floor import noise_floor
from gapscope.diagnosis.selection.search import Selection
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.torque_gap import TorqueGap, torque_gap, torque_scale


@dataclass(frozen=True)
class MeasuredGap:
    """What a selection leaves, n joints.

    Attributes:
        gap_after: on held-out data.
        inertial_mse: mean square that likely errors of the nominal inertials explain [N^2 m^2], (n,).
        floor: RMS that a healthy arm of this kind would leave [N m], (n,).
        residual: what exceeds the floor.
    """

    gap_after: TorqueGap
    inertial_mse: np.ndarray
    floor: np.ndarray
    residual: ExcessResidual


def measured_gap(predictor: HeldOutPredictor) -> MeasuredGap:
    """Gap, floor and excess residual with the selection of a predictor."""
    selection, terms = predictor.selection, predictor.selection.fit.terms
    gap_before, gap_after = predictor.gap(frozenset()), predictor.gap(terms)
    corrected = selection.corrected(selection.fit.theta, terms)
    fitted_gap = torque_gap(corrected, predictor.body, predictor.segments)
    inertial_mse = _inertial_error_mse(selection, fitted_gap)
    floor = np.sqrt(_noise_mse(predictor, corrected, fitted_gap) + inertial_mse)
    residual = excess_residual(selection, gap_after.rmse)
    if predictor.set_aside:
        on_set_aside = excess_residual_set_aside(
            selection, gap_before, gap_after, floor
        )
        residual = elementwise_max(residual, on_set_aside)
    return MeasuredGap(gap_after, inertial_mse, floor, residual)


def _noise_mse(
    predictor: HeldOutPredictor, corrected: CorrectedArm, gap: TorqueGap
) -> np.ndarray:
    """Mean square that noise, timing and form leave on a healthy arm, over all segments [N^2 m^2], (n,)."""
    segments, lengths = predictor.segments, np.diff(gap.edges)
    floors = [noise_floor(corrected, predictor.body, s).floor for s in segments]
    return np.average(np.square(floors), axis=0, weights=lengths)


def _inertial_error_mse(selection: Selection, gap: TorqueGap) -> np.ndarray:
    """Mean square that likely errors of the nominal inertials explain [N^2 m^2], (n,).

    The gap is measured twice: by the evidence, on the decimated rows of the search, and by ``torque_gap`` at the full
    rate. Inertial errors are known to the former only, hence the rescaling to the deviation of the latter's torque;
    the other place is ``excess_residual``, which takes the smaller of both.
    """
    evidence, terms = selection.evidence, selection.fit.terms

    with_errors = evidence.held_out_mse(terms, corrected=False)
    without_errors = evidence.likely_mse(terms)
    rows = evidence.rows
    explained = (with_errors * rows).sum(axis=0) - (without_errors * rows).sum(axis=0)
    explained = np.clip(explained, 0.0, None) / rows.sum(axis=0)

    full_rate_over_search = torque_scale(gap.measured) / selection.scale
    return np.asarray(explained * full_rate_over_search**2)
