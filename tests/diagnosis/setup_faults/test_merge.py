"""Findings of one fault on several joints become one finding."""

from __future__ import annotations

import numpy as np

from gapscope.diagnosis.setup_faults.found_fault import FoundFault
from gapscope.diagnosis.setup_faults.merge import merged
from gapscope.effects.setup_faults.channel_faults import (
    JointSwap,
    SignFlip,
    UnitMismatch,
)


def flip(joint: int, probability: float = 0.9) -> FoundFault:
    return FoundFault(SignFlip((joint,)), probability)


def test_two_flips_are_one_with_the_lower_probability() -> None:
    (found,) = merged((flip(3, 0.9), flip(1, 0.8)))
    assert (found.fault, found.probability) == (SignFlip((1, 3)), 0.8)


def test_values_are_sorted_with_their_joints() -> None:
    first, second = (
        FoundFault(
            UnitMismatch("motor_side", (joint,), ratio), 0.9, {"ratio": (0.1 * ratio,)}
        )
        for joint, ratio in ((2, 50.0), (1, 100.0))
    )
    (found,) = merged((first, second))
    assert found.fault == UnitMismatch("motor_side", (1, 2), (100.0, 50.0))
    assert found.std == {"ratio": (10.0, 5.0)}
    torque = found.reading(3).torque(np.ones((1, 3)))
    np.testing.assert_array_equal(torque, [[100.0, 50.0, 1.0]])


def test_a_swap_keeps_all_faults_apart() -> None:
    swap = FoundFault(JointSwap((1, 2)), 0.9)
    assert merged((flip(1), swap, flip(2))) == (flip(1), swap, flip(2))
