"""The document of a diagnosis, ``diagnosis.json``: checked against its schema and written whole or not at all."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match

from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.json_file import plain, write_json


@cache
def _validator() -> Draft202012Validator:
    text = (
        resources.files("gapscope.diagnosis.document")
        .joinpath("diagnosis.schema.json")
        .read_text(encoding="utf-8")
    )
    return Draft202012Validator(json.loads(text))


def validate(document: Mapping[str, Any]) -> None:
    """Check a document against ``diagnosis.schema.json`` and what a schema cannot say.

    Raises:
        GapscopeError: a field is missing or has a wrong value; the message names the field.
    """
    content = plain(document)
    for field, problem in _problems(content):
        raise GapscopeError(
            f"diagnosis.json, {f'field {field}' if field else 'top level'}: {problem}",
            "gapscope/diagnosis/document/diagnosis.schema.json describes the format",
        )


def write_document(document: Mapping[str, Any], path: Path | str) -> None:
    """Write a valid document as JSON; ``path`` never holds half of one.

    Raises:
        GapscopeError: the document is not valid, or ``path`` cannot be written.
    """
    validate(document)
    write_json(document, path)


def _problems(content: Any) -> Iterator[tuple[str, str]]:
    """Fields at fault, each with what is wrong with it."""
    yield from ((field, "is not a finite number") for field in _not_finite(content, ""))
    error = best_match(_validator().iter_errors(content))
    if error is not None:
        yield _field(error.absolute_path), error.message
        return
    yield from _wrong_lengths(content)
    n_effects, verdict = len(content["effects"]), content["verdict"]
    if (verdict == "effects_found" and not n_effects) or (
        verdict == "no_gap" and n_effects
    ):
        yield "verdict", f"is {verdict}, but effects lists {n_effects}"
    shares = [effect["share"] for effect in content["effects"]]
    if shares != sorted(shares, reverse=True):
        yield "effects", f"are not ordered by share: {shares}"


def _field(path: Any) -> str:
    return "".join(
        f"[{step}]" if isinstance(step, int) else f".{step}" for step in path
    ).lstrip(".")


def _not_finite(value: Any, field: str) -> Iterator[str]:
    if isinstance(value, dict):
        for key, entry in value.items():
            yield from _not_finite(entry, f"{field}.{key}".lstrip("."))
    elif isinstance(value, list):
        for index, entry in enumerate(value):
            yield from _not_finite(entry, f"{field}[{index}]")
    elif isinstance(value, float) and not math.isfinite(value):
        yield field


def _sides(sides: dict[str, Any] | None) -> Iterator[tuple[str, list[Any]]]:
    """Arrays over joints of the section on both sides of the sensors."""
    if sides is None:
        return
    for side in ("actuator", "link"):
        before = sides[side]["before"]
        yield f"{side}.before.torque_nrmse", before["torque_nrmse"]
        yield f"{side}.before.floor", before["floor"]
        yield f"{side}.after.torque_nrmse", sides[side]["after"]["torque_nrmse"]
    yield "carried_by", sides["carried_by"]
    yield from (
        (f"sensor.{name}.value", quantity["value"])
        for name, quantity in sides["sensor"].items()
    )


def _wrong_lengths(content: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Arrays over joints that do not fit the number of joints, joints that the arm does not have."""
    before, after = content["gap"]["before"], content["gap"]["after"]
    n = len(before["torque_nrmse"])
    arrays = {f"gap.before.{key}": before[key] for key in ("replay_rmse", "floor")}
    arrays |= {
        f"gap.after.{key}": after[key] for key in ("torque_nrmse", "replay_rmse")
    }
    if "arm" in content:
        arrays["arm.joints"] = content["arm"]["joints"]
    arrays |= _arrays_against(content.get("against"))
    joints: dict[str, list[int]] = {
        "unexplained.where": [
            region["joint"] for region in content["unexplained"]["where"]
        ]
    }
    joints["where"] = [region["joint"] for region in content.get("where", [])]
    for index, effect in enumerate(content["effects"]):
        field = f"effects[{index}]"
        arrays |= {
            f"{field}.{key}.torque_nrmse": effect[key]["torque_nrmse"]
            for key in _GAPS_OF_EFFECT
        }
        joints[f"{field}.joints"] = effect["joints"]
        joints[f"{field}.where"] = [region["joint"] for region in effect["where"]]
        yield from _wrong_parameters(effect, field)
    for name, value in _sides(content.get("sides")):
        arrays[f"sides.{name}"] = value
    for index, entry in enumerate(content.get("considered", [])):
        joints[f"considered[{index}].joints"] = entry["joints"]
    for field, array in arrays.items():
        if array is not None and len(array) != n:
            yield (
                field,
                f"has {len(array)} entries, but gap.before.torque_nrmse has {n}",
            )
    for field, numbers in joints.items():
        if max(numbers, default=0) > n:
            yield field, f"names joint {max(numbers)} of an arm with {n} joints"


def _arrays_against(against: dict[str, Any] | None) -> dict[str, Any]:
    """Arrays over joints of what was identified on a reference."""
    if against is None:
        return {}
    sheets = {
        "identified": against["identified"],
        "identified_std": against["identified_std"],
    }
    sheets |= {"held_out": against["held_out"], "today": against["today"]}
    keys = ("armature", "coulomb", "viscous", "rmse", "torque_nrmse")
    return {
        f"against.{name}.{key}": sheet[key]
        for name, sheet in sheets.items()
        for key in keys
        if key in sheet
    }


_GAPS_OF_EFFECT = ("gap_with_only_this", "gap_without_this")


def _wrong_parameters(effect: dict[str, Any], field: str) -> Iterator[tuple[str, str]]:
    """Parameters with another shape than the effect's joints, or a std with another shape than its value."""
    for name, parameter in effect["parameters"].items():
        value, std = parameter["value"], parameter["std"]
        count = len(value) if isinstance(value, list) else None
        if effect["joints"] and count != len(effect["joints"]):
            given = "a number" if count is None else f"{count} entries"
            yield (
                f"{field}.parameters.{name}.value",
                f"is {given}, but the effect acts on {len(effect['joints'])} joints",
            )
        if std is not None and (len(std) if isinstance(std, list) else None) != count:
            yield f"{field}.parameters.{name}.std", "does not have the shape of value"
