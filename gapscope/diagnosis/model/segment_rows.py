"""Rows of one segment in the linearised equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.gap.noise_floor import NoiseFloor
from gapscope.model.prediction import Prediction


@dataclass(frozen=True)
class SegmentRows:
    """Rows of one segment, M of them, of n joints, decimated to about twice the filter's cut-off.

    Attributes:
        gap: recorded less predicted torque [N m], (M, n).
        columns: A, the derivatives of the predicted torque by the P coordinates, (M, n, P).
        rate: d, the rate of the predicted torque [N m/s], (M, n).
        floor: what a healthy arm leaves on these rows.
        at: what the arm with the effects of theta_0 predicts, at every sample.
        known: 1 for rows whose torque was measured, next to nothing for others, (M, n).
    """

    gap: np.ndarray
    columns: np.ndarray
    rate: np.ndarray
    floor: NoiseFloor
    at: Prediction
    known: np.ndarray

    @property
    def trust(self) -> np.ndarray:
        """Square root of the weight of each row, (M, n): less while a joint may stick, none if it was not measured."""
        sticking = (self.floor.sticking / self.floor.steady) ** 2
        return np.asarray(np.sqrt(self.known / (1.0 + sticking)))
