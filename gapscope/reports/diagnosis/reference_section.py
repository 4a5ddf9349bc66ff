"""What a diagnosis against a reference was compared with, as the report shows it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gapscope.diagnosis.display import display_unit, percent, significant, uncertain
from gapscope.diagnosis.document.wording import (
    effect_name,
    joint_names,
    joint_ranges,
    listing,
)
from gapscope.diagnosis.result import Diagnosis
from gapscope.diagnosis.thresholds import LEAST_REFERENCE_SKEW
from gapscope.effects.catalogue import of_quantity
from gapscope.effects.effect import SHEET, Effect

ADDING = {key: of_quantity(quantity)[0] for quantity, key in SHEET.items()}
"""Effects that add to an entry of the data sheet, by its key."""


@dataclass(frozen=True)
class ReferenceJoint:
    """One joint: what was identified and what was allowed for.

    Attributes:
        label: ``J2``.
        name: name of the joint.
        identified: ``value ± std`` of each entry of ``ADDING``.
        today: Coulomb and viscous friction on the day of the case, each with its change in percent.
        held_out: torque NRMSE on stretches of the reference that were not fitted [1].
        errors: torque NRMSE that the likeliest errors of the identified arm come to [1].
    """

    label: str
    name: str
    identified: tuple[str, ...]
    today: tuple[str, ...]
    held_out: float | None
    errors: float | None


def against(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """Reference, what was identified on it per joint, and what was put down to another day; ``None`` without one."""
    content = diagnosis.document.get("against")
    if content is None:
        return None
    today = content["today"]
    return {
        "name": content["reference"],
        "recordings": content["recordings"],
        "parameters": content["base_parameters"],
        "law": content["friction_law"],
        "ratio": percent(content["torque_ratio_to_nominal"]),
        "skew": _skew(content["sampling_skew"]),
        "joints": _joints(content, joint_names(diagnosis.document)),
        "sheet": [_titled(effect) for effect in ADDING.values()],
        "allowed": percent(today["friction_allowed"]),
        "inherent": [
            _with_joints(e["effect"], e["joints"]) for e in content["inherent"]
        ],
    }


def _titled(effect: Effect) -> str:
    """Name and unit of an effect of one parameter."""
    _, unit = display_unit(effect.parameters[0].unit, 1.0)
    return f"{effect_name(effect.name)} [{unit}]"


def _skew(skew: float) -> str:
    """By how much the recorded torque is off in time, in words; empty if that is too little to be taken out."""
    if abs(skew) <= LEAST_REFERENCE_SKEW:
        return ""
    return (
        f"{significant(1e3 * abs(skew), 2)} ms {'ahead of' if skew > 0 else 'behind'}"
    )


def _joints(content: Mapping[str, Any], names: Sequence[str]) -> list[ReferenceJoint]:
    identified, std, today = (
        content["identified"],
        content["identified_std"],
        content["today"],
    )
    return [
        ReferenceJoint(
            label=f"J{j + 1}",
            name=name,
            identified=tuple(
                uncertain(identified[key][j], std[key][j]) for key in ADDING
            ),
            today=tuple(
                _changed(identified[key][j], today[key][j])
                for key in ("coulomb", "viscous")
            ),
            held_out=content["held_out"]["torque_nrmse"][j],
            errors=today["torque_nrmse"][j],
        )
        for j, name in enumerate(names)
    ]


def _changed(before: float, after: float) -> str:
    if not before:
        return significant(after)
    share = round(100.0 * (after / before - 1.0))
    sign = "−" if share < 0 else "+"
    return (
        f"{significant(after)} ({sign}{abs(share)} %)"
        if share
        else f"{significant(after)} (same)"
    )


def _with_joints(name: str, joints: Sequence[int]) -> str:
    where = (
        f" (joint{'s' if len(joints) > 1 else ''} {listing(joint_ranges(joints))})"
        if joints
        else ""
    )
    return effect_name(name) + where
