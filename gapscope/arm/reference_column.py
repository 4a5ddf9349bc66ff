"""What a recorded reference lacks of the one that the controller followed, put right.

``gapscope.effects.setup_faults.reference_faults`` makes the same faults in recordings.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from gapscope.arm.recording import Recording


def without_lead(recording: Recording, lead: float) -> Recording:
    """The recording with q_ref - (kd / kp) dq_ref as its reference position, which ``lead`` = kd / kp [s] is.

    Under gains kp and kd a controller that ignores its velocity reference commands what one does that uses it and is
    given this position: kp (q_ref - T dq_ref - q) + kd (dq_ref - dq) = kp (q_ref - q) - kd dq. The velocity's reference
    stays, for a feedforward; unchanged without a reference.
    """
    if recording.q_ref is None or lead == 0.0:
        return recording
    dq_ref = recording.dq_ref
    if dq_ref is None:
        dq_ref = np.gradient(recording.q_ref, recording.t, axis=0)
    return replace(recording, q_ref=recording.q_ref - lead * dq_ref, dq_ref=dq_ref)


def at_pace(recording: Recording, factor: float) -> Recording:
    """The recording with its reference at the arm's pace, q_ref(t0 + s (t - t0)); rows beyond its end are left out.

    Args:
        recording: unchanged without a reference.
        factor: s, the arm's speed over that of the recorded reference [1].
    """
    if recording.q_ref is None or factor == 1.0:
        return recording
    t = recording.t
    reached = t[0] + (t - t[0]) * factor
    inside = reached <= t[-1]
    changed: dict[str, Any] = {}
    for channel, times in (("q_ref", 1.0), ("dq_ref", factor)):
        series = getattr(recording, channel)
        if series is not None:
            columns = [np.interp(reached[inside], t, column) for column in series.T]
            changed[channel] = times * np.column_stack(columns)
    return replace(recording.part(inside), **changed)
