"""The torque that an arm predicts would be recorded, at every sample of a recording."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.recording import Recording
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import condition, pieces


def predict_torque(corrected: CorrectedArm, recording: Recording) -> np.ndarray:
    """Torque [N m], shape (N, n), finite at every sample; of the recording t, q and its known payload are used.

    An arm that has states has that of the recording, or of each of its spans; the last one if it is not known. If a
    stretch between gaps is too short to differentiate, the arm is taken to stand still.
    """
    out = np.empty_like(recording.q)
    for inside, arm in corrected.spans(recording.name, recording.t):
        out[inside] = _predicted(arm, recording)[inside]
    return out


def _predicted(corrected: CorrectedArm, recording: Recording) -> np.ndarray:
    """The torque of an arm in one state, (N, n)."""
    body = RigidBody(corrected.arm).carrying(recording.payload)
    # a spline needs moments that differ; back restores every row
    t, first, back = np.unique(recording.t, return_index=True, return_inverse=True)
    motion = Recording(recording.name, t, recording.q[first])
    at_rest = np.zeros_like(motion.q)
    # at rest nothing is late
    undelayed = tuple(e for e in corrected.effects if not e.effect.delays)
    torque = CorrectedArm(corrected.arm, undelayed).predict(
        body, Motion(t, motion.q, at_rest, at_rest)
    )
    spans = pieces(motion)
    if spans:
        for span, segment in zip(spans, condition(motion), strict=True):
            grid = segment.motion.t
            spline = make_interp_spline(
                grid, corrected.predict(body, segment.motion), k=3
            )
            torque[span] = spline(np.clip(t[span], grid[0], grid[-1]))
    return torque[back]
