"""Faults of the set-up among the findings, with the shares of faults and effects in one whole."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gapscope.diagnosis.document.entries import numbers
from gapscope.diagnosis.setup_faults.found_fault import FoundFault
from gapscope.diagnosis.thresholds import LEAST_PROBABILITY
from gapscope.effects.catalogue import known_effect, of_quantity
from gapscope.effects.effect import Turn

HANGING = -0.5
"""Gravity along the upright axis of the base, over the whole, of an arm that hangs, at most [1]."""


@dataclass(frozen=True)
class GapStages:
    """Torque NRMSE at the stages of a diagnosis, (n,) each.

    Attributes:
        recorded: of the case as it was given.
        repaired: with the faults of the set-up repaired.
        corrected: with the effects as well.
        floor: of a healthy arm.
    """

    recorded: np.ndarray
    repaired: np.ndarray
    corrected: np.ndarray
    floor: np.ndarray

    @property
    def whole(self) -> float:
        """The whole gap: what is above the floor, or what is closed if that is more."""
        return max(self._closable(self.recorded), 1e-9)

    @property
    def closed(self) -> float | None:
        """Share of the gap above the floor that is closed, ``None`` if no joint stands above its floor [1].

        1 - sum_j max(after_j - floor_j, 0) / sum_j max(before_j - floor_j, 0), at least 0: a joint below its floor pays
        for no other.
        """
        above = (self.recorded - self.floor).clip(0).sum()
        left = (self.corrected - self.floor).clip(0).sum()
        return max(0.0, float(1.0 - left / above)) if above > 0 else None

    @property
    def physical_share(self) -> float:
        """Share of the whole gap that remains for effects once the set-up is repaired [1]."""
        return min(self._closable(self.repaired) / self.whole, 1.0)

    def _closable(self, before: np.ndarray) -> float:
        above_floor = float((before - self.floor).clip(0).sum())
        closed = float((before - self.corrected).sum())
        return max(above_floor, closed)


def with_faults(
    effects: list[dict[str, Any]], faults: tuple[FoundFault, ...], gap: GapStages
) -> list[dict[str, Any]]:
    """Findings on effects and faults together, those with the largest share first.

    A fault's share is what repairing it takes from the whole gap; the effects share the rest. All together are what is
    closed.
    """
    rescaled = [_with_share_times(gap.physical_share, effect) for effect in effects]
    findings = rescaled + [_fault_finding(fault, gap) for fault in faults]
    total = sum(finding["share"] for finding in findings)
    if gap.closed is not None and total > 0:
        factor = gap.closed / total
        findings = [_with_share_times(factor, finding) for finding in findings]
    return sorted(findings, key=lambda finding: finding["share"], reverse=True)


def _with_share_times(factor: float, finding: dict[str, Any]) -> dict[str, Any]:
    interval = finding.get("share_interval", [])
    scaled = [min(bound * factor, 1.0) for bound in interval]
    entry = {**finding, "share": min(finding["share"] * factor, 1.0)}
    return entry | {"share_interval": scaled} if scaled else entry


def _fault_finding(fault: FoundFault, gap: GapStages) -> dict[str, Any]:
    only, without = fault.gap_with_only_this, fault.gap_without_this
    # A fault that cannot be simulated alone, such as quantisation, has no gaps of its own.
    if only is None:
        only = gap.recorded
    if without is None:
        without = gap.recorded
    share = (gap.recorded - only).sum() / gap.whole
    return {
        "effect": fault.name,
        "joints": list(fault.joints),
        "probability": fault.probability,
        **fault.document(),
        "share": float(np.clip(share, 0.0, 1.0)),
        "gap_with_only_this": {"torque_nrmse": numbers(only)},
        "gap_without_this": {"torque_nrmse": numbers(without)},
        "where": [],
        "alternatives": _alternatives(fault),
    }


def _alternatives(fault: FoundFault) -> list[dict[str, Any]]:
    """All torques turned are gravity turned, but for what does not turn with gravity."""
    if fault.turned_base is None:
        return []
    return [_other_sign(of_quantity("gravity")[0].name, [], fault.turned_base)]


def with_torques_turned(
    effects: list[dict[str, Any]], n_joints: int
) -> list[dict[str, Any]]:
    """Findings on effects; a base that hangs has all torques turned as its alternative."""
    return [_with_its_equivalent(effect, n_joints) for effect in effects]


def _with_its_equivalent(effect: dict[str, Any], n_joints: int) -> dict[str, Any]:
    turn = known_effect(effect["effect"])
    if not isinstance(turn, Turn):
        return effect
    angles = [effect["parameters"][name]["value"] for name in turn.names]
    # gravity along the base's axis that was upright, over the whole [1]
    if turn.rotation(*angles)[2, 2] > HANGING:
        return effect
    joints = list(range(1, n_joints + 1))
    other = _other_sign("sign_flip", joints, LEAST_PROBABILITY)
    return {**effect, "alternatives": [*effect["alternatives"], other]}


def _other_sign(name: str, joints: list[int], probability: float) -> dict[str, Any]:
    return {
        "effect": name,
        "joints": joints,
        "probability": probability,
        "separated_by": "a look at how the arm is mounted; or one joint moved slowly to and fro: friction opposes the "
        "motion if the base is turned, and would drive it if the torques were",
    }
