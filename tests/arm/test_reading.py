"""Readings of two joints, worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.arm.reading import Columns, Reading, advanced
from gapscope.arm.recording import Recording

RECORDED = np.array([[1.0, 2.0], [3.0, 4.0]])
SAME = Columns.identity(2)
SWAPPED = replace(SAME, source=(1, 0))
OFFSET = replace(SAME, offset=(0.0, 0.5))


def reading(**changed: Any) -> Reading:
    return Reading.identity(2, **changed)


def test_identity_gives_the_recording_itself() -> None:
    recording = Recording("r", np.arange(2.0), RECORDED, RECORDED)
    assert reading()(recording) is recording
    assert reading().to_mend() == {}


@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_a_time_scale_divides_velocity_once_and_acceleration_twice(
    factor: float,
) -> None:
    motion = reading(time_factor=factor).true_motion(RECORDED, RECORDED, RECORDED)
    for power, series in enumerate(motion):
        np.testing.assert_array_equal(series, RECORDED / factor**power)


def test_a_composition_reads_as_its_parts_one_after_the_other() -> None:
    t = 0.01 * np.arange(200)
    q = np.column_stack([np.sin(t), t])
    recording = Recording("r", t, q, 1.0 + t[:, None] * [1, 2], q_ref=q, dq_ref=q + 1)
    parts = (
        reading(motion=OFFSET, torque=SWAPPED, torque_delay=0.05),
        reading(motion=SWAPPED, lead=0.2, pace=0.5, time_factor=2.0),
        reading(torque_drift=0.1, lead=0.1, torque_delay=0.02),
    )
    whole = recording
    for part in parts:
        whole = part(whole)
    composed = parts[0].then(parts[1]).then(parts[2])(recording)
    # rows left out by the first are not there for the second
    kept = np.searchsorted(composed.t, whole.t - 1e-9)
    for channel in ("t", "q", "tau", "q_ref", "dq_ref"):
        np.testing.assert_allclose(
            getattr(composed, channel)[kept], getattr(whole, channel), atol=1e-4
        )


def test_a_late_torque_is_put_right_but_for_its_end_and_the_rows_before_a_gap() -> None:
    t = np.arange(0.0, 2.0, 0.004)
    q = np.sin(t[:, None] * [1.0, 2.0])
    recording = Recording("r", t, q, 10 * q)
    late = reading(torque_delay=0.02).inverse()(recording)
    right = advanced(late, 0.02)
    np.testing.assert_array_equal(right.t, t[:-5])
    np.testing.assert_allclose(right.tau, recording.tau[:-5], atol=1e-6)
    kept = np.r_[0:200, 300:500]
    gap = advanced(late.part(kept), 0.02)
    np.testing.assert_array_equal(gap.t, t[np.r_[0:195, 300:495]])
    with pytest.raises(InputError, match="delay"):
        advanced(recording, 5.0)


def test_gains_at_work_give_the_torque_of_their_joints_alone() -> None:
    q = np.zeros((3, 2))
    recording = Recording("r", np.arange(3.0), q, q + 7, dq=q, q_ref=q + 0.1, dq_ref=q)
    tau = reading(law=(None, (20.0, 3.0)))(recording).tau
    np.testing.assert_allclose(tau, [[7.0, 2.0]] * 3)
