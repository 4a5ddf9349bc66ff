"""What a recorded torque column lacks of the joint's torque, put right: gravity left out, or a delay of the driver.

``gapscope.effects.setup_faults.torque_faults`` makes the same faults in recordings.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording

GAP_STEPS = 4.0
"""A step of time longer than this many median steps is a gap, over which no torque is interpolated."""


def gravity_torque(recording: Recording, arm: NominalArm) -> np.ndarray:
    """g(q) of the nominal arm with the recording's known load, joint side [N m], (N, n)."""
    body = RigidBody(arm).carrying(recording.payload)
    still = np.zeros_like(recording.q)
    return body.inverse_dynamics(recording.q, still, still)


def with_gravity(recording: Recording, arm: NominalArm) -> Recording:
    """A recording whose torque is without gravity, as UR's ``actual_current_as_torque``, with g(q) added.

    tau = recorded tau + g(q), g of the nominal arm; unchanged without a torque.
    """
    if recording.tau is None:
        return recording
    return replace(recording, tau=recording.tau + gravity_torque(recording, arm))


def advanced(recording: Recording, delay: float, drift: float = 0.0) -> Recording:
    """A recording whose torque is late by ``delay`` [s] and a share ``drift`` [1] of its time, put right.

    tau(t) = recorded tau(t + delay + drift (t - t_0)), linear between samples. Rows whose torque was not recorded, at
    the end and before gaps, are left out; unchanged without a torque.

    Raises:
        InputError: the recording is not longer than the delay.
    """
    if recording.tau is None or (delay == 0.0 and drift == 0.0):
        return recording
    t = recording.t
    # a due time that is a sample's but for rounding is that sample's
    due = t + delay + drift * (t - t[0]) - 1e-9
    inside = due <= t[-1]
    after = np.clip(np.searchsorted(t, due), 1, len(t) - 1)
    inside &= t[after] - t[after - 1] <= GAP_STEPS / recording.rate
    if inside.sum() < 2:
        raise InputError(
            f"lasts {recording.duration:.3g} s, no longer than the delay of {due[0] - t[0]:.3g} s of its torque",
            "check the delay under import.mend.torque, in s",
            file=recording.name,
        )
    shifted = [np.interp(due[inside], t, column) for column in recording.tau.T]
    return replace(recording.part(inside), tau=np.column_stack(shifted))
