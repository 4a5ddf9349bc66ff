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
PER_JOINT = {"torque_nrmse", "replay_rmse", "rmse", "floor", *SHEET.values()}
"""Keys of arrays with one entry per joint; what is not known is null in their place, or in the place of an entry."""


def _nodes(value: Any, field: str = "") -> Iterator[tuple[str, Any]]:
    """All values in a document, each with its field."""
    yield field, value
    if isinstance(value, dict):
        for key, entry in value.items():
            yield from _nodes(entry, f"{field}.{key}".lstrip("."))
    elif isinstance(value, list):
        for index, entry in enumerate(value):
            yield from _nodes(entry, f"{field}[{index}]")


def not_finite(value: Any, field: str = "") -> Iterator[Problem]:
    """Numbers that JSON cannot hold, anywhere in a value."""
    for place, number in _nodes(value, field):
        if isinstance(number, float) and not math.isfinite(number):
            yield place, "is not a finite number"


def inconsistencies(content: dict[str, Any]) -> Iterator[Problem]:
    """Fields of a document that fits its schema, but contradict each other."""
    # the gap has one number per joint in every document: all else is held against it
    n = len(content["gap"]["before"]["torque_nrmse"])
    for field, node in _nodes(content):
        for key, problem in _of_entry(node, n) if isinstance(node, dict) else ():
            yield f"{field}.{key}".lstrip("."), problem
    verdict, effects = content["verdict"], len(content["effects"])
    changes = len(content.get("changes", []))
    found_none = verdict == "effects_found" and effects + changes == 0
    found_some = verdict == "no_gap" and effects + changes > 0
    if found_none or found_some:
        problem = f"is {verdict}, but effects lists {effects} and changes {changes}"
        yield "verdict", problem
    if content["unexplained"]["above_floor"] and verdict != "unexplained":
        yield "unexplained.above_floor", f"is true, but the verdict is {verdict}"
    for section in ("effects", "possible"):
        shares = [effect["share"] for effect in content[section]]
        if shares != sorted(shares, reverse=True):
            yield section, f"are not ordered by share: {shares}"


def _of_entry(entry: dict[str, Any], n: int) -> Iterator[Problem]:
    """What is wrong with an object of a document on an arm of n joints, by its keys."""
    for key in sorted(PER_JOINT & entry.keys()):
        count = _entries(entry[key])
        if count not in (None, n):
            yield key, f"has {count} entries, but gap.before.torque_nrmse has {n}"
    for key in ("joint", "joints"):
        joints = entry.get(key)
        every = joints if isinstance(joints, list) else [joints]
        largest = max((x for x in every if isinstance(x, int)), default=0)
        if largest > n:
            yield key, f"names joint {largest} of an arm with {n} joints"
    # only effects have values for their joints
    if not {"effect", "share"} <= entry.keys():
        return
    for name, parameter in entry.get("parameters", {}).items():
        value, std = parameter["value"], parameter["std"]
        count, n_joints = _entries(value), len(entry["joints"])
        # values of the arm or of a link have shapes of their own
        if n_joints and count != n_joints:
            given = "a number" if count is None else f"{count} entries"
            problem = f"is {given}, but the effect acts on {n_joints} joints"
            yield f"parameters.{name}.value", problem
        if std is not None and _entries(std) != count:
            yield f"parameters.{name}.std", "does not have the shape of value"


def _entries(value: Any) -> int | None:
    """Number of entries of a list; ``None`` for anything else."""
    return len(value) if isinstance(value, list) else None


# ``diagnosis.json``: checked against its schema, then written whole or not at all.


def validate(document: Mapping[str, Any]) -> None:
    """Check a document against ``diagnosis.schema.json`` and what a schema cannot say.

    Raises:
        GapscopeError: a field is missing or has a wrong value; the message names the field.
    """
    # as a file would hold it: arrays and tuples are lists
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
