"""The comparison of several units as data: ``units.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from gapscope.arm.case import load_case
from gapscope.arm.errors import GapscopeError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import PER_JOINT
from gapscope.diagnosis.fleet.compare_units import (
    SharedEffect,
    SharedParameter,
    compare,
    groups,
)
from gapscope.diagnosis.fleet.confusion import NOMINAL, ConfusionColumn, FleetUnit

SPOILS = (
    "sign_flip",
    "joint_swap",
    "unit_mismatch",
    "shifted_inertials",
    "torque_unit",
    "gravity_compensated_torque",
)
"""Faults of a set-up with which the recordings, or the arm believed, are of no use to another unit."""

Document = Mapping[str, Any]


@dataclass(frozen=True)
class FleetGroup:
    """Units of one type of arm.

    Attributes:
        robot: name of the robot.
        joints: names of its joints.
        documents: diagnosis of each unit.
        units: those that take part in the confusion.
        left_out: those that do not, and why.
        differ: what the cases do not believe alike of the nominal arm: ``urdf``, or entries of the data sheet.
    """

    robot: str
    joints: tuple[str, ...]
    documents: Mapping[str, Document]
    units: tuple[FleetUnit, ...]
    left_out: Mapping[str, str]
    differ: tuple[str, ...]


def grouped(
    documents: Mapping[str, Document], units: Sequence[FleetUnit]
) -> tuple[tuple[FleetGroup, ...], tuple[str, ...]]:
    """Groups of two and more units of one type of arm, and the units that are alone.

    Args:
        documents: diagnosis of each unit, by its name.
        units: where each unit's case and ``corrected.yaml`` lie.
    """
    made = []
    for (robot, joints), members in groups(documents).items():
        if len(members) > 1:
            own = [unit for unit in units if unit.name in members]
            made.append(_fleet_group(robot, joints, members, own))
    compared = {unit for group in made for unit in group.documents}
    return tuple(made), tuple(unit for unit in documents if unit not in compared)


def _fleet_group(
    robot: str,
    joints: tuple[str, ...],
    documents: Mapping[str, Document],
    units: Sequence[FleetUnit],
) -> FleetGroup:
    """The group of units of one type of arm; those with a faulty set-up take no part in the confusion."""
    problems = {unit: _spoilt(document) for unit, document in documents.items()}
    sound = tuple(unit for unit in units if not problems[unit.name])
    return FleetGroup(
        robot,
        joints,
        documents,
        sound if len(sound) > 1 else (),
        {unit: problem for unit, problem in problems.items() if problem},
        _differ(units),
    )


def units_document(
    made: Sequence[tuple[FleetGroup, Sequence[ConfusionColumn]]], alone: Sequence[str]
) -> dict[str, Any]:
    """Content of ``units.json``: per type of arm the effects compared and, with columns, the confusion."""
    return {
        "schema": 1,
        "groups": [_group(*entry) for entry in made],
        "alone": list(alone),
    }


def _spoilt(document: Document) -> str:
    found = [
        entry["effect"].replace("_", " ")
        for entry in document["effects"]
        if entry["effect"] in SPOILS
    ]
    return f"its set-up is at fault: {', '.join(found)}" if found else ""


def _differ(units: Sequence[FleetUnit]) -> tuple[str, ...]:
    """What the nominal arms of units do not have alike."""
    try:
        arms = [load_case(unit.case, read_recordings=False).arm for unit in units]
    except GapscopeError:  # the case was changed since; its column shows it
        return ()
    first, *others = arms
    urdf = first.urdf.read_bytes()
    differ = []
    if any(arm.urdf.read_bytes() != urdf for arm in others):
        differ.append("urdf")
    for key in PER_JOINT:
        if not all(_same(first, arm, key) for arm in others):
            differ.append(key)
    return tuple(differ)


def _same(one: NominalArm, other: NominalArm, key: str) -> bool:
    a, b = getattr(one, key), getattr(other, key)
    if a is None or b is None:
        return a is b
    return bool(np.allclose(a, b, rtol=1e-6))


def _group(group: FleetGroup, columns: Sequence[ConfusionColumn]) -> dict[str, Any]:
    return {
        "robot": group.robot,
        "joints": list(group.joints),
        "units": list(group.documents),
        "nominal_differs": list(group.differ),
        "effects": [_effect(row) for row in compare(group.documents)],
        "confusion": _confusion(columns, group.left_out),
    }


def _effect(row: SharedEffect) -> dict[str, Any]:
    return {
        "effect": row.effect,
        "joint": row.joint,
        "link": row.link,
        "kind": row.kind,
        "units": list(row.units),
        "agree": row.agree,
        "shares": dict(row.shares),
        "instead": dict(row.instead),
        "parameters": [_value(value) for value in row.values],
    }


def _value(value: SharedParameter) -> dict[str, Any]:
    together = None if value.pooled is None else asdict(value.pooled)
    return {
        "name": value.name,
        "component": value.component,
        "unit": value.unit,
        "value": dict(value.values),
        "std": dict(value.stds),
        "together": together,
    }


def _confusion(
    columns: Sequence[ConfusionColumn], left_out: Mapping[str, str]
) -> dict[str, Any]:
    """Means over the joints and values per joint, rows by columns; problems of columns count as left out."""
    shown = [c for c in columns if not c.problem]
    rows = [NOMINAL, *(c.unit for c in columns)] if shown else []
    per_joint = [[c.torque_nrmse.get(row) for c in shown] for row in rows]
    return {
        "rows": rows,
        "columns": [c.unit for c in shown],
        "torque_nrmse": [[c.mean(row) for c in shown] for row in rows],
        "torque_nrmse_per_joint": [
            [None if v is None else v.tolist() for v in line] for line in per_joint
        ],
        "best": {c.unit: c.best for c in shown},
        "confused_with": {c.unit: list(c.confused_with) for c in shown},
        "left_out": {**left_out, **{c.unit: c.problem for c in columns if c.problem}},
    }
