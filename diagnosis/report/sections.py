"""Sections of the report: each takes a diagnosis and returns what its part of the template shows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from diagnosis.quantities import MISSING, display_unit, significant
from diagnosis.result import Diagnosis
from diagnosis.wording import (
    VERDICTS,
    ParameterText,
    gap_closed,
    gap_rows,
    joint_names,
    parameter_texts,
    short_names,
    unexplained_sentence,
    verdict_sentence,
)
from effects.catalogue import CATALOGUE

FIRST_SCREEN_EFFECTS = 4
"""Effects shown with their parameters on the first screen; all of them follow below."""


FLOOR_SCALE = 4.0
"""The bars' axis reaches at least this many times the highest floor, so that a healthy arm's bars look small."""


@dataclass(frozen=True)
class JointGap:
    """One row of the per-joint chart: torque NRMSE [1] and replay RMSE [rad], ``None`` where not known."""

    label: str
    name: str
    short: str
    before: float | None
    after: float | None
    floor: float | None
    replay_before: str
    replay_after: str


@dataclass(frozen=True)
class FoundEffect:
    """One effect found, with its parameters as text and what the catalogue says of it."""

    entry: Mapping[str, Any]
    parameters: list[ParameterText]
    family: str
    equation: str
    looks_like: str
    only_this: list[float | None]
    without_this: list[float | None]
    signatures: list[int]


def heading(diagnosis: Diagnosis) -> dict[str, str]:
    """Name of the case, robot, verdict as a label and as a sentence."""
    document = diagnosis.document
    return {
        "robot": document.get("arm", {}).get("robot", ""),
        "verdict": VERDICTS[document["verdict"]],
        "sentence": verdict_sentence(document),
    }


def where(diagnosis: Diagnosis) -> dict[str, Any]:
    """Gap per joint, the scale of its bars, and the regions that hold most of it."""
    gap = diagnosis.document["gap"]
    before, after = gap["before"], gap["after"]
    names = joint_names(diagnosis.document)
    columns = zip(
        names, short_names(names), before["torque_nrmse"], after["torque_nrmse"], before["floor"],
        *_angles(before["replay_rmse"] or [None] * len(names), after["replay_rmse"] or [None] * len(names)),
        strict=True,
    )  # fmt: skip
    joints = [JointGap(f"J{number}", *column) for number, column in enumerate(columns, 1)]
    values = [value for joint in joints for value in (joint.before, joint.after) if value is not None]
    floors = [joint.floor for joint in joints if joint.floor is not None]
    return {
        "joints": joints,
        "scale": max([*values, FLOOR_SCALE * max(floors, default=0.0)], default=0.0) or 1.0,
        "regions": list({r["joint"]: r for r in reversed(diagnosis.document.get("where", []))}.values())[::-1],
        "replayed": any(joint.replay_before != MISSING for joint in joints),
    }


def which(diagnosis: Diagnosis) -> dict[str, Any]:
    """The effects found, ordered by share; without any, what came closest to explaining the gap."""
    effects = [_found(entry, diagnosis) for entry in diagnosis.document["effects"]]
    unexplained = diagnosis.document["verdict"] == "unexplained"
    return {
        "effects": effects,
        "first": effects[:FIRST_SCREEN_EFFECTS],
        "more": len(effects) - FIRST_SCREEN_EFFECTS,
        "closest": diagnosis.document.get("considered", [])[:3] if unexplained else [],
    }


def how_far(diagnosis: Diagnosis) -> dict[str, Any]:
    """Share of the gap closed, and means over the joints of the gap before, after and the floor."""
    document = diagnosis.document
    before, after = document["gap"]["before"], document["gap"]["after"]
    rows = [row for row in gap_rows(document) if None not in row]
    closed = gap_closed(document)
    [replay_before], [replay_after] = _angles([_mean(before["replay_rmse"])], [_mean(after["replay_rmse"])])
    return {
        "closed": closed,
        "bar": None if closed is None else max(0.0, closed),
        "mean": {name: _mean([row[i] for row in rows]) for i, name in enumerate(("before", "after", "floor"))},
        "replay": {"before": replay_before, "after": replay_after},
        "judged_on": document.get("judged_on", "data that was not used to fit"),
    }


def left_over(diagnosis: Diagnosis) -> dict[str, Any]:
    """What no effect explains, and what was considered instead of the effects found."""
    document = diagnosis.document
    return {
        "sentence": unexplained_sentence(document),
        "regions": document["unexplained"]["where"],
        "considered": document.get("considered", []),
    }


def inputs(diagnosis: Diagnosis) -> dict[str, Any]:
    """Recordings, how they were conditioned, warnings."""
    document = diagnosis.document
    return {
        "recordings": document.get("recordings", []),
        "conditioning": document.get("conditioning"),
        "warnings": document.get("warnings", []),
        "traces": len(diagnosis.traces),
        "spectrum": diagnosis.spectrum.frequency.size > 0,
    }


SECTIONS: tuple[Callable[[Diagnosis], dict[str, Any]], ...] = (heading, where, which, how_far, left_over, inputs)


def _found(entry: Mapping[str, Any], diagnosis: Diagnosis) -> FoundEffect:
    definition = CATALOGUE.get(entry["effect"])
    own = [
        index
        for index, signature in enumerate(diagnosis.signatures)
        if signature.effect == entry["effect"] and (signature.joint in entry["joints"] or not entry["joints"])
    ]
    return FoundEffect(
        entry=entry,
        parameters=parameter_texts(entry),
        family=definition.family.replace("_", " ") if definition else "",
        equation=definition.equation if definition else "",
        looks_like=definition.looks_like if definition else "",
        only_this=list(entry["gap_with_only_this"]["torque_nrmse"]),
        without_this=list(entry["gap_without_this"]["torque_nrmse"]),
        signatures=own,
    )


def _mean(values: Iterable[float | None] | None) -> float | None:
    known = [value for value in values or [] if value is not None]
    return sum(known) / len(known) if known else None


def _angles(*columns: list[float | None]) -> list[list[str]]:
    """Columns of angles [rad] as text, all in the one unit that suits the largest."""
    factor, unit = display_unit("rad", max((value for column in columns for value in column if value), default=0.0))
    name = unit if unit == "°" else f" {unit}"
    return [
        [MISSING if value is None else significant(factor * value, 2) + name for value in column] for column in columns
    ]
