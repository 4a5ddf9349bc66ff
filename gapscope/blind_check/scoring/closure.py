"""How much of the gap above the floor a corrected arm closes on the recording that was held out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.case import load_case
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.recording import Recording
from gapscope.blind_check.generator.measure import residual, rms
from gapscope.diagnosis.gap.predict import predict_torque
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import read_corrected_arm

ABOVE = 2.0
"""A joint counts when its gap is this many times its floor."""


def closure(
    case: Path, unseen: Path, corrected: Path, floor: np.ndarray
) -> dict[str, Any] | None:
    """Share of the gap above the floor that is closed on held-out data.

    (before - after) / (before - floor), each a torque NRMSE; ``mean`` sums above and below the line over the joints
    that count, ``worst`` is the smallest share among them.

    Args:
        case: folder of the case.
        unseen: the recording held out; of it t and q are predicted from, the torque compared with.
        corrected: ``corrected.yaml`` of the diagnosis.
        floor: torque NRMSE of the healthy twin, (n,).

    Returns:
        ``None`` if no joint is above its floor or nothing can be predicted.
    """
    try:
        loaded = load_case(case, read_recordings=False)
        recording = load_recording(unseen, loaded.arm, loaded.importing, every_row=True)
        arm = read_corrected_arm(loaded.arm, corrected)
        before = _nrmse(CorrectedArm(loaded.arm), recording)
        after = _nrmse(arm, recording) if arm.effects else before
    except (GapscopeError, ValueError):
        return None
    counts = before > ABOVE * floor
    if not counts.any():
        return None
    gained, wanted = (before - after)[counts], (before - floor)[counts]
    return {
        "mean": float(np.clip(gained.sum() / wanted.sum(), -1.0, 1.0)),
        "worst": float(np.clip((gained / wanted).min(), -1.0, 1.0)),
        "before": before.tolist(),
        "after": after.tolist(),
    }


def _nrmse(arm: CorrectedArm, recording: Recording) -> np.ndarray:
    """Torque NRMSE of an arm on a recording, (n,); if torque saturates, of what reached the joint."""
    predicted = predict_torque(arm, recording)
    assert recording.tau is not None
    torque = recording.tau
    for effect in arm.effects:
        if effect.name == "torque_saturation":
            columns = np.array(effect.joints) - 1
            limit = effect.parameters["limit"]
            torque = torque.copy()
            torque[:, columns] = np.clip(torque[:, columns], -limit, limit)
            predicted[:, columns] = np.clip(predicted[:, columns], -limit, limit)
    t = recording.t
    rate = (len(t) - 1) / (t[-1] - t[0])
    gap, _ = residual(torque, predicted, rate)
    # the scale is that of the torque as it was recorded, also under saturation
    _, scale = residual(recording.tau, predicted, rate)
    return rms(gap) / scale
