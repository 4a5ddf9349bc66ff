"""Channel mappings of two joints, worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.diagnosis.setup_faults.channel_mapping import (
    ChannelMapping,
    flipped,
    offset_by,
    scaled,
    shifted,
    swapped,
    timed,
)

RECORDED = np.array([[1.0, 2.0], [3.0, 4.0]])


def test_identity_changes_nothing() -> None:
    mapping = ChannelMapping.identity(2)
    for series in mapping.motion(RECORDED, RECORDED, RECORDED):
        np.testing.assert_array_equal(series, RECORDED)
    np.testing.assert_array_equal(mapping.torque(RECORDED), RECORDED)


@pytest.mark.parametrize(
    ("channel", "motion_turned", "torque_turned"),
    [("torque", False, True), ("position", True, False), ("joint", True, True)],
)
def test_a_flip_turns_the_sign_of_its_channel_alone(
    channel: str, motion_turned: bool, torque_turned: bool
) -> None:
    mapping = flipped(2, 1, channel)
    turned = RECORDED * [1.0, -1.0]
    q, _, _ = mapping.motion(RECORDED, RECORDED, RECORDED)
    np.testing.assert_array_equal(q, turned if motion_turned else RECORDED)
    torque = mapping.torque(RECORDED)
    np.testing.assert_array_equal(torque, turned if torque_turned else RECORDED)


def test_a_swap_of_torque_leaves_the_motion() -> None:
    mapping = swapped(2, (0, 1), "torque")
    np.testing.assert_array_equal(mapping.torque(RECORDED), [[2.0, 1.0], [4.0, 3.0]])
    np.testing.assert_array_equal(
        mapping.motion(RECORDED, RECORDED, RECORDED)[0], RECORDED
    )


def test_a_time_scale_divides_velocity_once_and_acceleration_twice() -> None:
    q, dq, ddq = timed(2, 2.0).motion(RECORDED, RECORDED, RECORDED)
    np.testing.assert_array_equal(q, RECORDED)
    np.testing.assert_array_equal(dq, RECORDED / 2)
    np.testing.assert_array_equal(ddq, RECORDED / 4)


def test_the_second_mapping_acts_on_the_result_of_the_first() -> None:
    both = scaled(2, (0,), 10.0).then(swapped(2, (0, 1), "joint"))
    q, _, _ = both.motion(RECORDED, RECORDED, RECORDED)
    np.testing.assert_array_equal(q, [[2.0, 10.0], [4.0, 30.0]])


def test_shifts_and_time_factors_add_up() -> None:
    both = shifted(2, 1).then(shifted(2, -1, moved_only=True)).then(timed(2, 3.0))
    assert (both.link_shift, both.moved_only, both.time_factor) == (0, True, 3.0)
    assert both.equation_key != ChannelMapping.identity(2).equation_key


def test_an_offset_is_added_to_positions_alone_and_passes_through_what_follows() -> (
    None
):
    offset = offset_by(2, 1, 0.5)
    q, dq, _ = offset.motion(RECORDED, RECORDED, RECORDED)
    np.testing.assert_allclose(q, np.add(RECORDED, [0.0, 0.5]))
    np.testing.assert_array_equal(dq, RECORDED)
    # read with the offset, then with the joints exchanged and the first of them turned
    both = offset.then(swapped(2, (0, 1), "joint")).then(flipped(2, 0, "position"))
    q, _, _ = both.motion(RECORDED, RECORDED, RECORDED)
    np.testing.assert_allclose(q, RECORDED[:, ::-1] * [-1, 1] - [0.5, 0.0])
