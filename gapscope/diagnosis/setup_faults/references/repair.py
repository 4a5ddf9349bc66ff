"""Recordings with faults of references put right; each fault as ``gapscope.effects.setup_faults`` makes it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from gapscope.arm.recording import Recording
from gapscope.arm.reference_column import at_pace, without_lead
from gapscope.diagnosis.setup_faults.references.set_points import set_points
from gapscope.effects.setup_faults.reference_faults import references


def without_velocity(recording: Recording) -> Recording:
    """The recording without its velocity, which was the reference's: that of the positions takes its place."""
    return replace(recording, dq=None)


def smoothed(recording: Recording) -> Recording:
    """The recording with a smooth reference through its set points; as it is if it has none."""
    points = set_points(recording)
    return recording if points is None else points.smooth(recording)


def by_gains(
    recording: Recording, joints: tuple[int, ...], kp: np.ndarray, kd: np.ndarray
) -> Recording:
    """The recording with kp (q_ref - q) + kd (dq_ref - dq) as the torque of joints that count from 1."""
    q_ref, dq_ref = references(recording, "unmeasured_torque")
    if recording.dq is None or recording.tau is None:
        return recording
    columns, tau = np.array(joints) - 1, np.array(recording.tau)
    error, rate = q_ref - recording.q, dq_ref - recording.dq
    tau[:, columns] = kp * error[:, columns] + kd * rate[:, columns]
    return replace(recording, tau=tau)


def reference_repaired(
    name: str,
    joints: tuple[int, ...],
    values: Mapping[str, tuple[float, ...]],
    recording: Recording,
) -> Recording:
    """A recording with a fault of this folder put right; the same object for any other fault.

    Args:
        name: of the fault.
        joints: from 1.
        values: of its parameters, by name.
        recording: which has the fault.
    """
    if recording.q_ref is None:
        return recording
    repairs: dict[str, Callable[[], Recording]] = {
        "velocity_of_reference": lambda: without_velocity(recording),
        "ignored_velocity_reference": lambda: without_lead(
            recording, values["lead"][0]
        ),
        "speed_scaling": lambda: at_pace(recording, values["factor"][0]),
        "coarse_reference": lambda: smoothed(recording),
    }
    if name == "unmeasured_torque" and "kp_at_work" in values:
        kp, kd = np.array(values["kp_at_work"]), np.array(values["kd_at_work"])
        return by_gains(recording, joints, kp, kd)
    return repairs[name]() if name in repairs else recording
