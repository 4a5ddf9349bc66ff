"""Faults of the set-up among the findings: shares of one whole, worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.diagnosis.document.fault_findings import (
    GapStages,
    with_faults,
    with_torques_turned,
)
from gapscope.diagnosis.setup_faults.found_fault import FoundFault
from gapscope.effects.setup_faults.channel_faults import SignFlip

EFFECT = {"effect": "armature", "share": 0.5, "share_interval": [0.4, 0.6]}


def stages(recorded: float, repaired: float, corrected: float) -> GapStages:
    """Joint 1 has the gaps, joint 2 is at its floor."""
    floor = np.array([0.1, 0.1])
    gaps = (np.array([gap, 0.1]) for gap in (recorded, repaired, corrected))
    return GapStages(*gaps, floor)


def fault(only: float | None) -> FoundFault:
    gap = None if only is None else np.array([only, 0.1])
    return FoundFault(SignFlip((1,)), 0.99, gap_with_only_this=gap)


def test_without_faults_the_effects_share_the_whole() -> None:
    gap = stages(recorded=0.6, repaired=0.6, corrected=0.35)
    (effect,) = with_faults([EFFECT], (), gap)
    assert effect["share"] == pytest.approx(0.5)
    assert effect["share_interval"] == pytest.approx([0.4, 0.6])


def test_shares_add_up_to_what_is_closed() -> None:
    """Of 0.5 above the floor 0.4 are closed: effects with shares of 0.26 and 0.14 have twice as much."""
    gap = stages(recorded=0.6, repaired=0.6, corrected=0.2)
    small = {"effect": "torque_offset", "share": 0.14, "share_interval": [0.1, 0.2]}
    large = EFFECT | {"share": 0.26}
    first, second = with_faults([small, large], (), gap)
    assert gap.closed == pytest.approx(0.8)
    assert (first["share"], second["share"]) == pytest.approx((0.52, 0.28))


def test_a_joint_below_its_floor_pays_for_no_other() -> None:
    """0.2 of 0.4 above the floor is left on joint 1; joint 2, far below its floor, changes nothing."""
    gap = GapStages(
        recorded=np.array([0.5, 0.05]),
        repaired=np.array([0.5, 0.05]),
        corrected=np.array([0.3, 0.0]),
        floor=np.array([0.1, 0.1]),
    )
    assert gap.closed == pytest.approx(0.5)


def test_a_gap_that_grows_is_closed_by_nothing_and_none_is_not_closed() -> None:
    assert stages(recorded=0.5, repaired=0.5, corrected=0.7).closed == 0.0
    assert stages(recorded=0.1, repaired=0.1, corrected=0.05).closed is None


def test_a_fault_takes_its_part_of_the_whole_and_leaves_the_rest() -> None:
    """Of 1.0 above the floor a repair leaves 0.4: the fault has 0.6, an effect with half of the rest 0.2."""
    gap = stages(recorded=1.1, repaired=0.5, corrected=0.3)
    first, second = with_faults([EFFECT], (fault(only=0.5),), gap)
    assert (first["effect"], first["share"]) == ("sign_flip", pytest.approx(0.6))
    assert (second["effect"], second["share"]) == ("armature", pytest.approx(0.2))
    assert second["share_interval"] == pytest.approx([0.16, 0.24])
    assert first["gap_with_only_this"] == {"torque_nrmse": [0.5, 0.1]}


def test_a_fault_without_a_gap_of_its_own_has_no_share() -> None:
    gap = stages(recorded=1.1, repaired=1.1, corrected=0.1)
    first, second = with_faults([EFFECT], (fault(only=None),), gap)
    assert (first["effect"], second["share"]) == ("armature", 0.0)
    assert second["gap_without_this"] == {"torque_nrmse": [1.1, 0.1]}


def test_the_whole_is_what_is_closed_if_the_floor_is_estimated_too_high() -> None:
    gap = stages(recorded=0.12, repaired=0.12, corrected=0.02)
    assert gap.whole == pytest.approx(0.1)


def test_all_torques_turned_and_a_base_that_hangs_are_each_others_alternative() -> None:
    turned = FoundFault(SignFlip((1, 2)), 0.9, turned_base=0.1)
    gap = stages(recorded=0.6, repaired=0.1, corrected=0.1)
    (flip,) = with_faults([], (turned,), gap)
    (other,) = flip["alternatives"]
    assert (other["effect"], other["probability"]) == ("base_tilt", 0.1)
    assert "friction" in other["separated_by"]

    def tilt(roll: float) -> dict[str, object]:
        angles = {"roll": {"value": roll}, "pitch": {"value": 0.1}}
        return {"effect": "base_tilt", "parameters": angles, "alternatives": []}

    (hung, tilted) = with_torques_turned([tilt(3.0), tilt(0.1)], 2)
    assert [o["effect"] for o in hung["alternatives"]] == ["sign_flip"]
    assert hung["alternatives"][0]["joints"] == [1, 2]
    assert tilted["alternatives"] == []
