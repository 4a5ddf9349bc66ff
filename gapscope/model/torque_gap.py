"""The torque gap: what the arm predicts against what was recorded, per joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import TORQUE_CUTOFF, Segment, low_pass, torque_scale
from gapscope.model.rows import DecimatedSegments


@dataclass(frozen=True)
class TorqueGap:
    """Gap of several segments, filtered at 12 Hz and trimmed, stacked over time; n joints.

    Attributes:
        measured, predicted: torque [N m], shape (M, n).
    """

    measured: np.ndarray
    predicted: np.ndarray

    @property
    def error(self) -> np.ndarray:
        """Recorded minus predicted torque [N m], (M, n)."""
        return self.measured - self.predicted

    @property
    def rmse(self) -> np.ndarray:
        """Root mean square of the gap [N m], (n,)."""
        return np.sqrt((self.error**2).mean(axis=0))

    @property
    def nrmse(self) -> np.ndarray:
        """``torque_nrmse`` [1], (n,)."""
        return self.rmse / torque_scale(self.measured)


def torque_gap(
    corrected: CorrectedArm, body: RigidBody, segments: list[Segment]
) -> TorqueGap:
    """Torque gap of an arm on segments that carry a torque; ``body``: of the nominal arm without known loads.

    An arm that has states has that of each recording, or of its spans.
    """
    measured, predicted = [], []
    for segment in segments:
        rate, inner = segment.motion.rate, segment.inner
        assert segment.torque is not None
        prediction, delivered = np.empty((2, *segment.torque.shape))
        for there, arm in corrected.spans(segment.recording, segment.motion.t):
            # a limit cuts off what is recorded, not what is needed
            torque = arm.unlimited.predict(segment.bodies(body), segment.motion)
            prediction[there] = torque[there]
            delivered[there] = arm.delivered(segment.torque, segment.motion)[there]
        prediction_rows = low_pass(prediction, rate, TORQUE_CUTOFF)[inner]
        predicted.append(prediction_rows)
        if segment.unknown is None:
            measured.append(low_pass(delivered, rate, TORQUE_CUTOFF)[inner])
            continue
        # what was not measured leaves no gap
        gap = segment.bridged(delivered - prediction)
        gap = low_pass(gap, rate, TORQUE_CUTOFF)[inner] * ~segment.unknown[inner]
        # as if it had been measured: the prediction plus what is left of the gap
        measured.append(prediction_rows + gap)
    return TorqueGap(np.vstack(measured), np.vstack(predicted))


def gap_on_rows(
    rows: DecimatedSegments, corrected: CorrectedArm, body: RigidBody
) -> np.ndarray:
    """Torque gap of an arm on decimated rows, as it is [N m], (M, n)."""
    gaps = []
    for segment in rows.segments:
        assert segment.torque is not None
        # a limit cuts off what is recorded, not what is needed
        predicted = corrected.unlimited.predict(segment.bodies(body), segment.motion)
        delivered = corrected.delivered(segment.torque, segment.motion)
        gaps.append(segment.bridged(delivered - predicted))
    return rows.rows(gaps)
