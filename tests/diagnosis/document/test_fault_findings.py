"""Faults of the set-up among the findings: shares of one whole, worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.diagnosis.document.fault_findings import GapStages, with_faults
from gapscope.diagnosis.setup_faults.found_fault import FoundFault

EFFECT = {"effect": "armature", "share": 0.5, "share_interval": [0.4, 0.6]}


def stages(recorded: float, repaired: float, corrected: float) -> GapStages:
    """Joint 1 has the gaps, joint 2 is at its floor."""
    floor = np.array([0.1, 0.1])
    gaps = (np.array([gap, 0.1]) for gap in (recorded, repaired, corrected))
    return GapStages(*gaps, floor)


def fault(only: float | None) -> FoundFault:
    gap = None if only is None else np.array([only, 0.1])
    return FoundFault("sign_flip", (1,), "torque", {}, 0.99, gap_with_only_this=gap)


def test_without_faults_the_effects_share_the_whole() -> None:
    gap = stages(recorded=0.6, repaired=0.6, corrected=0.1)
    assert with_faults([EFFECT], (), gap) == [EFFECT]


def test_a_fault_takes_its_part_of_the_whole_and_leaves_the_rest() -> None:
    """Of 1.0 above the floor a repair leaves 0.4: the fault has 0.6, an effect with half of the rest 0.2."""
    gap = stages(recorded=1.1, repaired=0.5, corrected=0.1)
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
