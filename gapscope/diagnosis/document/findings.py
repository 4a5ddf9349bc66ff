"""Findings of a diagnosis: effects with their parameters, faults of the set-up, states, and what else is to be said."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gapscope.arm.display import effect_name, listing, percent
from gapscope.arm.nominal import NominalArm
from gapscope.arm.root_mean_square import SMALLEST
from gapscope.diagnosis.agreement import DIFFERS, Agreement
from gapscope.diagnosis.comparison import (
    LONGER_RECORDING,
    NONE,
    Alternative,
    separated_by,
)
from gapscope.diagnosis.document.wording import Verdict, coupling_text
from gapscope.diagnosis.locate import Region
from gapscope.diagnosis.selection.undeclared_coupling import UndeclaredCoupling
from gapscope.diagnosis.setup_faults.found_fault import FoundFault, TurnedBase
from gapscope.diagnosis.states import OtherState, States
from gapscope.diagnosis.thresholds import OPEN_ALTERNATIVE
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE, known_effect
from gapscope.effects.effect import Turn
from gapscope.effects.setup_faults import Fault
from gapscope.model.conditioning import torque_scale
from gapscope.model.terms import Terms

# Small parts of ``diagnosis.json`` that several sections share.


Finding = dict[str, Any]


def region_entry(region: Region) -> dict[str, Any]:
    """A region as the document holds it."""
    return {
        "joint": region.joint,
        "kind": region.kind,
        "regime": region.regime,
        "share": region.share,
        "coverage": region.coverage,
        "enrichment": region.enrichment,
        **region.detail,
    }


# What a finding on an effect says beside its values.


LISTED_ALTERNATIVE = 1e-3
"""Alternatives less probable than this are not listed."""


def settled_by(finding: dict[str, Any]) -> str:
    """The recording that separates a possible effect from its likeliest alternative."""
    # two names of one body: no recording tells them apart
    others = [o for o in finding["alternatives"] if not o.get("equivalent")]
    if others:
        return str(others[0]["separated_by"])
    return LONGER_RECORDING


def gravity_entry(applied: AppliedEffect, arm: NominalArm) -> dict[str, Any]:
    """Gravity in the frame of a base that is turned, R^T g [m/s^2]: what a case file says it as."""
    effect = CATALOGUE.get(applied.name)
    if not isinstance(effect, Turn):
        return {}
    angles = (float(np.ravel(applied.parameters[name])[0]) for name in effect.names)
    return {"gravity": effect.rotation(*angles).T @ arm.gravity}


def at_middle_entry(applied: AppliedEffect, q: np.ndarray) -> dict[str, Any]:
    """Torque of springs at the middle of recorded positions (M, n), if they rest beyond them [N m]."""
    effect = CATALOGUE.get(applied.name)
    if effect is None or "rest" not in effect.quantities.values():
        return {}
    # where a spring rests beyond what was recorded is hardly known
    range_of_joints = q[:, [joint - 1 for joint in applied.joints]]
    low, high = range_of_joints.min(axis=0), range_of_joints.max(axis=0)
    # in the order of the catalogue
    stiffness, rest = applied.parameters.values()
    torque = stiffness * ((low + high) / 2 - rest)
    beyond = (rest < low) | (rest > high)
    if not beyond.any():
        return {}
    pairs = zip(torque.tolist(), beyond.tolist(), strict=True)
    return {"torque_at_middle": [value if far else None for value, far in pairs]}


def alternative_entry(effect: str, other: Alternative) -> dict[str, Any]:
    """An alternative to an effect as the document holds it."""
    return {
        "effect": other.effect,
        "joints": other.joints,
        "probability": other.probability,
        "evidence": other.evidence,
        "separated_by": separated_by(effect, other),
        "equivalent": other.equivalent,
    }


def share_entry(closed_first: float, closed_last: float, whole: float) -> Finding:
    """Share of the gap that a finding closes: the mean of what it does first and last (Shapley of two orders)."""
    ends = np.clip(
        np.sort([closed_first, closed_last]) / max(whole, SMALLEST), 0.0, 1.0
    )
    return {"share": float(ends.mean()), "share_interval": ends.tolist()}


# Faults of the set-up among the findings, with the shares of faults and effects in one whole.


TURNED_TORQUES = 0.02
"""Probability that the torques of an arm that seems to hang are turned instead [1]. (hand)"""
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
        return max(self._closable(self.recorded), SMALLEST)

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
    # what faults and effects close one by one does not add up: scaled to what all close
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
        # as if it changed nothing
        only = gap.recorded
    if without is None:
        without = gap.recorded
    share = (gap.recorded - only).sum() / gap.whole
    return {
        "effect": fault.name,
        "joints": fault.joints,
        "probability": fault.probability,
        **({} if fault.log_odds is None else {"support": {"log_odds": fault.log_odds}}),
        **fault.document(),
        "share": float(np.clip(share, 0.0, 1.0)),
        "gap_with_only_this": {"torque_nrmse": only},
        "gap_without_this": {"torque_nrmse": without},
        "where": [],
        "alternatives": [
            _other_reading(other, probability)
            for other, probability in fault.others
            if probability >= LISTED_ALTERNATIVE
        ],
    }


WATCHED = (
    "each of these joints moved slowly by itself while one watches which way it turns: its column rises with it, and "
    "its torque has the sign of the motion"
)
"""What tells faults of single joints apart."""
WRITTEN = (
    "what the driver says of its columns and its rate, and the robot file of its links"
)
"""What tells faults of the whole arm from others."""


def _other_reading(fault: Fault, probability: float) -> dict[str, Any]:
    name, variant, joints = fault.kind
    # no fault, but an effect that competed: the mounting tells, not the columns
    if isinstance(fault, TurnedBase):
        return _other_sign(name, [], probability)
    return {
        "effect": name,
        **({"variant": variant} if variant else {}),
        "joints": joints,
        "probability": probability,
        "separated_by": WATCHED if joints else WRITTEN,
    }


def with_torques_turned(effect: dict[str, Any], n_joints: int) -> dict[str, Any]:
    """A finding on an effect; a base that hangs has all torques turned as its alternative."""
    turn = known_effect(effect["effect"])
    if not isinstance(turn, Turn):
        return effect
    angles = [effect["parameters"][name]["value"] for name in turn.names]
    # gravity along the base's axis that was upright, over the whole [1]
    if turn.rotation(*angles)[2, 2] > HANGING:
        return effect
    # turned torques are those of all joints
    joints = list(range(1, n_joints + 1))
    other = _other_sign("sign_flip", joints, TURNED_TORQUES)
    return {**effect, "alternatives": [*effect["alternatives"], other]}


def _other_sign(name: str, joints: list[int], probability: float) -> dict[str, Any]:
    return {
        "effect": name,
        "joints": joints,
        "probability": probability,
        "separated_by": "a look at how the arm is mounted; or one joint moved slowly to and fro: friction opposes the "
        "motion if the base is turned, and would drive it if the torques were",
    }


# Findings of a case whose recordings do not share a state: what holds where.


def with_states(
    findings: Sequence[Finding],
    states: States,
    terms: Terms,
    theta: np.ndarray,
) -> list[Finding]:
    """Findings with the recordings in which they hold, and what other recordings have in their place.

    Args:
        findings: of the recordings in the first state.
        states: of all recordings.
        terms: terms.
        theta: coordinates of the effects found, (P,).
    """
    found, others = states.found, states.others
    if found is None or not others:
        return list(findings)
    differing = {term.effect for state in others for term in state.increments}
    # the first state is the one that was diagnosed
    here = [found.recordings[k].name for k in found.states[0]]
    # what all recordings share is said without naming any
    out = [
        {**f, "recordings": here, "elsewhere": []} if f["effect"] in differing else f
        for f in findings
    ]
    for state in others:
        there = state.theta(terms, theta)
        for applied in terms.effects(there):
            if applied.name not in differing:
                continue
            place = {
                "recordings": state.place.recordings,
                "joints": applied.joints,
                "parameters": _parameters(applied, state, terms, there),
            }
            # found here with other values, or found only there
            twins = [f for f in out if f["effect"] == applied.name]
            if twins:
                twins[0].setdefault("elsewhere", []).append(place)
            else:
                out.append(
                    {**_evidence(applied, state, found), **place, "elsewhere": []}
                )
    return sorted(out, key=lambda finding: -finding["share"])


def _parameters(
    applied: AppliedEffect, state: OtherState, terms: Terms, theta: np.ndarray
) -> dict[str, Any]:
    """Values at a place, and their deviations as far as they follow from what differs there."""
    variances = {n: np.zeros(applied.parameters[n].shape) for n in applied.given}
    # terms without any value there make no effect
    mine = [t for t in terms.of(applied.name) if theta[list(t.columns)].any()]
    for term in mine:
        if term not in state.increments:
            continue
        for column, deviation in zip(
            term.columns, state.increments[term].deviation, strict=True
        ):
            # half of a central difference: parameters need not be linear in coordinates
            step = np.zeros(len(theta))
            step[column] = deviation
            (more,) = terms.effects(terms.clipped(theta + step), mine)
            (less,) = terms.effects(terms.clipped(theta - step), mine)
            for name, variance in variances.items():
                half = (more.parameters[name] - less.parameters[name]) / 2
                variances[name] = variance + half**2
    return {
        parameter.name: {
            "unit": parameter.unit,
            "value": applied.parameters[parameter.name],
            "std": np.sqrt(variances[parameter.name]),
        }
        for parameter in map(applied.effect.parameter, applied.given)
    }


def _evidence(applied: AppliedEffect, state: OtherState, found: Agreement) -> Finding:
    """Probability and gaps of an effect that the first state has not, in a recording that has it."""
    assert found.found is not None
    # recordings of one state have the same of their own: the first stands for all
    fit, name = found.found.fit, state.place.recordings[0]
    number = next(k for k, r in enumerate(found.recordings) if r.name == name)
    rows = fit.contrast.design.rows
    mine = rows.of(number)
    left = rows.in_newton_metres(fit.left)[mine]
    every = state.increments.items()
    # the gap that this recording would have in the first state
    whole = left + sum(x.torque for _, x in every)
    this = sum(x.torque for term, x in every if term.effect == applied.name)

    def nrmse(gap: np.ndarray) -> np.ndarray:
        return np.sqrt((gap**2).mean(axis=0)) / torque_scale(rows.torque[mine])

    before, after = nrmse(whole), nrmse(left)
    only, without = nrmse(whole - this), nrmse(left + this)
    closed = float((before - only).sum()), float((without - after).sum())
    differing = [
        line for line in found.having(DIFFERS) if line.term.effect == applied.name
    ]
    return {
        "effect": applied.name,
        # as sure as the surest of its joints
        "probability": max(1.0 - (line.p or 0.0) for line in differing),
        "gap_with_only_this": {"torque_nrmse": only},
        "gap_without_this": {"torque_nrmse": without},
        **share_entry(*closed, float(before.sum())),
        "where": [],
        "alternatives": [],
    }


# The next recording that a diagnosis suggests, from its own findings; ``gapscope advise`` designs it in detail.


NOT_YET = "none yet: "
"""How a next recording begins that is something to do first."""


def suggested_recording(
    reached: Verdict,
    effects: list[dict[str, Any]],
    possible: list[dict[str, Any]],
    open_joints: list[int],
    coupling: UndeclaredCoupling | None = None,
    first: str = "",
) -> str | None:
    """What to record, or to declare first, why, and what it will tell; ``None`` if nothing is open.

    A missing cause comes before the names of those found: among these it may have a proxy.

    Args:
        reached: the verdict; without a gap nothing is open.
        effects: findings that are named.
        possible: findings that are possible only.
        open_joints: joints whose residual the verdict calls unexplained, from 1.
        coupling: two joints that seem to be turned by one motor.
        first: what to correct in the case before that.
    """
    if reached == "no_gap":
        return None
    if first:
        return f"{NOT_YET}first {first}, and diagnose again"
    # a motor that the case lacks explains friction of two joints: that comes first
    if coupling is not None:
        return (
            f"{NOT_YET}first look whether one motor turns joints {coupling.joint} and {coupling.motor}, declare it in "
            f"the case as {coupling_text(coupling.declaration)}, and diagnose again"
        )
    if open_joints:
        one = len(open_joints) == 1
        joints, move = ("joint", "it") if one else ("joints", "each of them")
        return (
            f"to find what is unexplained on {joints} {listing(list(map(str, open_joints)))}: move {move} alone, along "
            "the same path at half and at double speed; a torque that stays as large acts by position or is dry "
            "friction, one that doubles with the speed is damping, one that grows fourfold is inertia"
        )
    # doubts about what is named come before what is only possible
    for findings in (effects, possible):
        rivals = [
            (rival["probability"], _kind(finding), rival)
            for finding in findings
            for rival in finding["alternatives"]
            # no recording tells two names of one cause apart
            if not rival.get("equivalent") and rival["probability"] >= OPEN_ALTERNATIVE
        ]
        if rivals:
            _, effect, rival = max(rivals, key=lambda entry: entry[0])
            return _to_tell_apart(effect, rival)
    return None


def _to_tell_apart(name: str, rival: dict[str, Any]) -> str:
    likely, recording = percent(rival["probability"]), rival["separated_by"]
    if rival["effect"] == NONE:
        return (
            f"to tell {name} from nothing, which has a probability of {likely}: {recording}; an effect is found again "
            "there, chance is not"
        )
    asks = f"to tell {name} from {_kind(rival)}, which has a probability of {likely}: {recording}"
    if rival["separated_by"] in (WATCHED, WRITTEN):
        return asks
    return f"{asks}; the one that predicts it keeps its name"


def _kind(entry: dict[str, Any]) -> str:
    """Readable name of an effect, or of a fault with its variant."""
    name = effect_name(entry["effect"])
    return f"{name} ({entry['variant']})" if "variant" in entry else name
