"""``diagnosis.json``: what a schema cannot say of it, and how it is read and written."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.json_file import field as schema_field
from gapscope.arm.io.json_file import plain, read_json, schema_fault, write_json
from gapscope.effects.effect import SHEET

# What a JSON schema cannot say of ``diagnosis.json``: finite numbers, matching lengths, joints, order, verdict.


Problem = tuple[str, str]
"""A field, and what is wrong with it."""


def not_finite(value: Any, field: str = "") -> Iterator[Problem]:
    """Numbers that JSON cannot hold, anywhere in a value."""
    if isinstance(value, dict):
        for key, entry in value.items():
            yield from not_finite(entry, f"{field}.{key}".lstrip("."))
    elif isinstance(value, list):
        for index, entry in enumerate(value):
            yield from not_finite(entry, f"{field}[{index}]")
    elif isinstance(value, float) and not math.isfinite(value):
        yield field, "is not a finite number"


def inconsistencies(content: dict[str, Any]) -> Iterator[Problem]:
    """Fields of a document that fits its schema, but contradict each other."""
    for field, effect in _findings(content):
        yield from _wrong_parameters(effect, field)
    yield from _wrong_lengths(content)
    yield from _unknown_joints(content)
    yield from _wrong_verdict(content)
    for section in ("effects", "possible"):
        shares = [effect["share"] for effect in content[section]]
        if shares != sorted(shares, reverse=True):
            yield section, f"are not ordered by share: {shares}"


def _findings(content: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """All findings, named and possible, each with its field."""
    for section in ("effects", "possible"):
        for index, effect in enumerate(content[section]):
            yield f"{section}[{index}]", effect


def _wrong_verdict(content: dict[str, Any]) -> Iterator[Problem]:
    verdict, effects = content["verdict"], len(content["effects"])
    changes = len(content.get("changes", []))
    found_none = verdict == "effects_found" and effects + changes == 0
    found_some = verdict == "no_gap" and effects + changes > 0
    if found_none or found_some:
        yield (
            "verdict",
            f"is {verdict}, but effects lists {effects} and changes {changes}",
        )
    if content["unexplained"]["above_floor"] and verdict != "unexplained":
        yield "unexplained.above_floor", f"is true, but the verdict is {verdict}"


def _wrong_parameters(effect: dict[str, Any], field: str) -> Iterator[Problem]:
    """Parameters with another shape than the effect's joints, or a std with another shape than its value."""
    n_joints = len(effect["joints"])
    for name, parameter in effect["parameters"].items():
        value, std = parameter["value"], parameter["std"]
        count = _entries(value)
        if n_joints and count != n_joints:
            given = "a number" if count is None else f"{count} entries"
            problem = f"is {given}, but the effect acts on {n_joints} joints"
            yield f"{field}.parameters.{name}.value", problem
        if std is not None and _entries(std) != count:
            yield f"{field}.parameters.{name}.std", "does not have the shape of value"


def _entries(value: Any) -> int | None:
    """Number of entries of a list; ``None`` for a number."""
    return len(value) if isinstance(value, list) else None


def _wrong_lengths(content: dict[str, Any]) -> Iterator[Problem]:
    """Arrays over joints that do not fit the number of joints."""
    n = _n_joints(content)
    for field, array in _arrays_over_joints(content):
        # what is not known is null in place of the array
        if array is not None and len(array) != n:
            problem = f"has {len(array)} entries, but gap.before.torque_nrmse has {n}"
            yield field, problem


def _unknown_joints(content: dict[str, Any]) -> Iterator[Problem]:
    """Joints that the arm does not have."""
    n = _n_joints(content)
    for field, joints in _joint_numbers(content):
        largest = max(joints, default=0)
        if largest > n:
            yield field, f"names joint {largest} of an arm with {n} joints"


def _n_joints(content: dict[str, Any]) -> int:
    return len(content["gap"]["before"]["torque_nrmse"])


def _arrays_over_joints(
    content: dict[str, Any],
) -> Iterator[tuple[str, list[Any] | None]]:
    """All arrays with one entry per joint."""
    before, after = content["gap"]["before"], content["gap"]["after"]
    yield "gap.before.replay_rmse", before["replay_rmse"]
    yield "gap.before.floor", before["floor"]
    yield "gap.after.torque_nrmse", after["torque_nrmse"]
    yield "gap.after.replay_rmse", after["replay_rmse"]
    if "arm" in content:
        yield "arm.joints", content["arm"]["joints"]
    if content.get("against") is not None:
        yield from _arrays_of_reference(content["against"])
    for field, effect in _findings(content):
        for key in ("gap_with_only_this", "gap_without_this"):
            yield f"{field}.{key}.torque_nrmse", effect[key]["torque_nrmse"]
    if content.get("sides") is not None:
        yield from _arrays_of_sides(content["sides"])


def _arrays_of_reference(against: dict[str, Any]) -> Iterator[tuple[str, list[Any]]]:
    """Arrays over joints of what was identified on a reference."""
    for section in ("identified", "identified_std", "held_out", "today"):
        for key in (*SHEET.values(), "rmse", "torque_nrmse"):
            if key in against[section]:
                yield f"against.{section}.{key}", against[section][key]


def _arrays_of_sides(sides: dict[str, Any]) -> Iterator[tuple[str, list[Any]]]:
    """Arrays over joints of the section on both sides of the sensors."""
    for side in ("actuator", "link"):
        before, after = sides[side]["before"], sides[side]["after"]
        yield f"sides.{side}.before.torque_nrmse", before["torque_nrmse"]
        yield f"sides.{side}.before.floor", before["floor"]
        yield f"sides.{side}.after.torque_nrmse", after["torque_nrmse"]
    yield "sides.carried_by", sides["carried_by"]
    for name, quantity in sides["sensor"].items():
        yield f"sides.sensor.{name}.value", quantity["value"]


def _joint_numbers(content: dict[str, Any]) -> Iterator[tuple[str, list[int]]]:
    """All lists of joints by their numbers."""
    yield "unexplained.where", _joints_of(content["unexplained"]["where"])
    yield "where", _joints_of(content.get("where", []))
    for field, effect in _findings(content):
        yield f"{field}.joints", effect["joints"]
        yield f"{field}.where", _joints_of(effect["where"])
    for index, entry in enumerate(content.get("considered", [])):
        yield f"considered[{index}].joints", entry["joints"]


def _joints_of(regions: list[dict[str, Any]]) -> list[int]:
    return [region["joint"] for region in regions]


# ``diagnosis.json``: checked against its schema, then written whole or not at all.


def validate(document: Mapping[str, Any]) -> None:
    """Check a document against ``diagnosis.schema.json`` and what a schema cannot say.

    Raises:
        GapscopeError: a field is missing or has a wrong value; the message names the field.
    """
    first = next(_problems(plain(document)), None)
    if first is None:
        return
    field, problem = first
    place = f"field {field}" if field else "top level"
    raise GapscopeError(
        f"diagnosis.json, {place}: {problem}",
        "gapscope/schemas/diagnosis.schema.json describes the format",
    )


def write_document(document: Mapping[str, Any], path: Path | str) -> None:
    """Write a valid document as JSON; ``path`` never holds half of one.

    Raises:
        GapscopeError: the document is not valid, or ``path`` cannot be written.
    """
    validate(document)
    write_json(document, path)


def read_document(path: Path) -> Mapping[str, Any]:
    """A ``diagnosis.json``.

    Raises:
        InputError: it is missing, or not of its schema.
    """
    remedy = "give the folder that gapscope diagnose wrote"
    content = read_json(path, remedy)
    if not isinstance(content, dict):
        raise InputError("is no diagnosis", remedy, file=path)
    try:
        validate(content)
    except GapscopeError as error:
        raise InputError(error.message, remedy, file=path) from None
    return content


def _problems(content: Any) -> Iterator[Problem]:
    """Fields at fault, each with what is wrong with it."""
    yield from not_finite(content)
    error = schema_fault(content, "diagnosis")
    if error is None:
        yield from inconsistencies(content)
    else:
        # The checks beyond the schema need the fields that it demands.
        yield schema_field(error.absolute_path), error.message
