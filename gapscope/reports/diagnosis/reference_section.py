"""What a diagnosis against a reference was compared with, as the report shows it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gapscope.arm.display import (
    MISSING,
    display_unit,
    effect_name,
    percent,
    significant,
    uncertain,
)
from gapscope.diagnosis.document.wording import joint_names, joint_ranges, listing
from gapscope.diagnosis.result import Diagnosis
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
        "joints": _joints(content, joint_names(diagnosis.document)),
        "sheet": [_titled(effect) for effect in ADDING.values()],
        "allowed": percent(today["friction_allowed"]),
        "inherent": [
            _with_joints(e["effect"], e["joints"]) for e in content["inherent"]
        ],
        "lacking": _lacking(content),
        "expected": _expected(content, len(joint_names(diagnosis.document))),
    }


def _expected(content: Mapping[str, Any], n_joints: int) -> list[tuple[str, list[str]]]:
    """How large an effect would have to be to be named in nine cases of ten: name and unit, then a text per joint."""
    rows: dict[str, list[str]] = {}
    for entry in content.get("expected", ()):
        factor, unit = display_unit(entry["unit"], 1.0)
        unit = "" if entry["unit"] == "1" else f" [{unit}]"
        name = f"{effect_name(entry['effect'])}, {entry['parameter'].replace('_', ' ')}{unit}"
        texts = rows.setdefault(name, [""] * n_joints)
        value = entry["nine_of_ten"]
        text = MISSING if value is None else significant(factor * value, 2)
        for joint in entry["joints"] or [1]:
            texts[joint - 1] = text
    return list(rows.items())


def _lacking(content: Mapping[str, Any]) -> str:
    """What possible bodies lack at most of a joint's torque; empty in a document that does not say so."""
    remainder = content.get("remainder")
    return percent(max(remainder["torque_nrmse"])) if remainder else ""


def _titled(effect: Effect) -> str:
    """Name and unit of an effect of one parameter."""
    _, unit = display_unit(effect.parameters[0].unit, 1.0)
    return f"{effect_name(effect.name)} [{unit}]"


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
