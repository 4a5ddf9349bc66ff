"""Findings of one fault on several joints become one finding."""

from __future__ import annotations

from gapscope.diagnosis.setup_faults.channel_mapping import flipped, swapped
from gapscope.diagnosis.setup_faults.found_fault import FaultParameter, FoundFault
from gapscope.diagnosis.setup_faults.merge import merged


def flip(joint: int, probability: float = 0.9) -> FoundFault:
    mapping = flipped(3, joint - 1, "torque")
    return FoundFault("sign_flip", (joint,), "torque", {}, probability, mapping=mapping)


def test_two_flips_are_one_with_the_lower_probability() -> None:
    (found,) = merged((flip(3, 0.9), flip(1, 0.8)))
    assert (found.joints, found.probability) == ((1, 3), 0.8)
    assert found.mapping is not None
    assert found.mapping.torque_factor == (-1.0, 1.0, -1.0)


def test_values_are_sorted_with_their_joints() -> None:
    first, second = (
        FoundFault(
            "unit_mismatch",
            (joint,),
            "motor_side",
            {"ratio": FaultParameter("1", (ratio,), (1.0,))},
            0.9,
            mapping=flipped(3, joint - 1, "joint"),
        )
        for joint, ratio in ((2, 50.0), (1, 100.0))
    )
    (found,) = merged((first, second))
    assert found.parameters["ratio"].value == (100.0, 50.0)
    assert found.parameters["ratio"].std == (1.0, 1.0)


def test_a_swap_keeps_all_faults_apart() -> None:
    swap = FoundFault(
        "joint_swap", (1, 2), "torque", {}, 0.9, mapping=swapped(3, (0, 1), "torque")
    )
    assert merged((flip(1), swap, flip(2))) == (flip(1), swap, flip(2))
