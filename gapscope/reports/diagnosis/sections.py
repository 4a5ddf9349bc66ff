"""Sections of the report: each takes a diagnosis and returns what its part of the template shows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gapscope.arm.display import MISSING, display_unit, effect_name, significant
from gapscope.diagnosis.document.sentences import (
    nominal_friction_sentence,
    presliding_sentence,
    unexplained_sentence,
    verdict_sentence,
)
from gapscope.diagnosis.document.wording import (
    VERDICTS,
    ParameterText,
    gap_rows,
    joint_names,
    joint_slides,
    parameter_texts,
    pulled_texts,
    short_names,
)
from gapscope.diagnosis.result import Diagnosis
from gapscope.effects.catalogue import known_effect
from gapscope.effects.effect import Effect
from gapscope.reports.diagnosis.guesses import guesses
from gapscope.reports.diagnosis.places import pictures
from gapscope.reports.diagnosis.reference_section import against

FIRST_SCREEN_EFFECTS = 4
"""Effects shown with their parameters on the first screen; all of them follow below."""

LEARNT = ("rule", "interval", "line")
"""Kinds of regions that were learnt from the gap and hold a part of the motion."""

ENGINE_NAMES = {"mujoco": "MuJoCo", "dart": "DART"}
"""Engines as their makers write them."""

FLOOR_SCALE = 4.0
"""The bars' axis reaches at least this many times the highest floor, so that a healthy arm's bars look small."""


@dataclass(frozen=True)
class JointGap:
    """One row of the per-joint chart: torque NRMSE [1] and replay RMSE [rad], ``None`` if not known."""

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
    """One effect found, with its parameters as text and its record, ``None`` if this process does not know it."""

    entry: Mapping[str, Any]
    parameters: list[ParameterText]
    definition: Effect | None
    only_this: list[float | None]
    without_this: list[float | None]
    signatures: list[int]
    pulled: list[str]


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
        names,
        short_names(names),
        before["torque_nrmse"],
        after["torque_nrmse"],
        before["floor"],
        *_motions(
            joint_slides(diagnosis.document),
            before["replay_rmse"] or [None] * len(names),
            after["replay_rmse"] or [None] * len(names),
        ),
        strict=True,
    )
    joints = [
        JointGap(f"J{number}", *column) for number, column in enumerate(columns, 1)
    ]
    values = [
        value
        for joint in joints
        for value in (joint.before, joint.after)
        if value is not None
    ]
    floors = [joint.floor for joint in joints if joint.floor is not None]
    return {
        "joints": joints,
        "scale": max([*values, FLOOR_SCALE * max(floors, default=0.0)], default=0.0)
        or 1.0,
        "regions": _first_and_learnt(diagnosis.document.get("where", [])),
        "telling": _most_telling(diagnosis.document.get("where", [])),
        "pictures": pictures(diagnosis, "before"),
        "replayed": any(joint.replay_before != MISSING for joint in joints),
    }


def which(diagnosis: Diagnosis) -> dict[str, Any]:
    """The effects named and the possible ones, by share; without any, what came closest to explaining the gap."""
    effects, possible = (
        [_found(entry, diagnosis) for entry in diagnosis.document[section]]
        for section in ("effects", "possible")
    )
    unexplained = diagnosis.document["verdict"] == "unexplained"
    return {
        "effects": effects,
        "possible": possible,
        "first": effects[:FIRST_SCREEN_EFFECTS],
        "more": len(effects) - FIRST_SCREEN_EFFECTS,
        "closest": diagnosis.document.get("considered", [])[:3] if unexplained else [],
    }


def how_far(diagnosis: Diagnosis) -> dict[str, Any]:
    """Share of the gap closed, and means over the joints of the gap before, after and the floor."""
    document = diagnosis.document
    before, after = document["gap"]["before"], document["gap"]["after"]
    rows = [row for row in gap_rows(document) if None not in row]
    closed = None if document["verdict"] == "no_gap" else document["closed"]
    replay_before, replay_after = _mean_motions(
        document, before["replay_rmse"], after["replay_rmse"]
    )
    return {
        "closed": closed,
        "mean": {
            name: _mean([row[i] for row in rows])
            for i, name in enumerate(("before", "after", "floor"))
        },
        "replay": {
            "before": replay_before,
            "after": replay_after,
            "by_torque": document["gap"].get("replayed") == "torque",
        },
        "elsewhere": [
            _elsewhere(document, engine, before, after)
            for engine in before.get("replay_elsewhere", {})
        ],
        "judged_on": document.get("judged_on", "data that was not used to fit"),
    }


def _elsewhere(
    document: Mapping[str, Any],
    engine: str,
    before: dict[str, Any],
    after: dict[str, Any],
) -> dict[str, str]:
    """Mean replay gap before and after in another engine."""
    gaps = [stage["replay_elsewhere"].get(engine) for stage in (before, after)]
    first, second = _mean_motions(document, *gaps)
    return {
        "engine": ENGINE_NAMES.get(engine, engine),
        "before": first,
        "after": second,
    }


def left_over(diagnosis: Diagnosis) -> dict[str, Any]:
    """What no effect explains, and what was considered instead of the effects found."""
    document = diagnosis.document
    return {
        "sentence": unexplained_sentence(document),
        "regions": document["unexplained"]["where"],
        "joints": _above_floor(document),
        "pictures": pictures(diagnosis, "after"),
        "guesses": guesses(diagnosis),
        "considered": document.get("considered", []),
    }


def inputs(diagnosis: Diagnosis) -> dict[str, Any]:
    """Recordings, how they were conditioned, warnings."""
    document = diagnosis.document
    return {
        "recordings": document.get("recordings", []),
        "conditioning": document.get("conditioning"),
        "warnings": document.get("warnings", []),
        "nominal_friction": nominal_friction_sentence(document),
        "presliding": presliding_sentence(document),
        "inferred": document.get("torque_from") == "controller",
        "traces": len(diagnosis.traces),
        "spectrum": diagnosis.spectrum.frequency.size > 0,
    }


SECTIONS: tuple[Callable[[Diagnosis], dict[str, Any] | None], ...] = (
    heading,
    where,
    which,
    how_far,
    left_over,
    inputs,
    against,
)


def _found(entry: Mapping[str, Any], diagnosis: Diagnosis) -> FoundEffect:
    own = [
        index
        for index, signature in enumerate(diagnosis.signatures)
        if signature.effect == entry["effect"]
        and (signature.joint in entry["joints"] or not entry["joints"])
    ]
    return FoundEffect(
        entry=entry,
        parameters=parameter_texts(entry),
        definition=known_effect(entry["effect"]),
        only_this=list(entry["gap_with_only_this"]["torque_nrmse"]),
        without_this=list(entry["gap_without_this"]["torque_nrmse"]),
        signatures=own,
        pulled=pulled_texts(entry),
    )


def _first_and_learnt(regions: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Of each joint what was learnt from its gap, and without a rule the first that was cut in advance."""
    joints = [region["joint"] for region in regions]
    ruled = {region["joint"] for region in regions if region.get("kind") == "rule"}
    return [
        r
        for i, r in enumerate(regions)
        if r.get("kind") in LEARNT
        or (joints.index(r["joint"]) == i and r["joint"] not in ruled)
    ]


def _most_telling(regions: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Of each joint the region that holds most of the gap in least of the time; a band of frequency if it is all."""
    out: dict[int, dict[str, Any]] = {}
    for region in regions:
        known = out.setdefault(region["joint"], region)
        if known is not region and _telling(region) > _telling(known):
            out[region["joint"]] = region
    return list(out.values())


def _telling(region: Mapping[str, Any]) -> float:
    """Share times log concentration; less than any other for what only a specialist reads."""
    if region.get("kind") in ("frequency", "coherence"):
        return -1.0
    return float(region["share"] * np.log(max(region.get("enrichment") or 1.0, 1.0)))


def _above_floor(document: Mapping[str, Any]) -> list[tuple[int, str, list[str]]]:
    """Joints left above the floor: number, how many times the floor, and the effects named on them."""
    if not document["unexplained"]["above_floor"] or not document["effects"]:
        return []
    out = []
    for joint in document["unexplained"].get("joints", []):
        named = [
            effect_name(entry["effect"])
            for entry in document["effects"]
            if joint in entry["joints"]
        ]
        out.append(
            (
                joint,
                significant(document["unexplained"]["times_floor"][joint - 1], 2),
                named,
            )
        )
    return out


def _mean(values: Iterable[float | None] | None) -> float | None:
    known = [value for value in values or [] if value is not None]
    return sum(known) / len(known) if known else None


def _mean_motions(
    document: Mapping[str, Any], *columns: list[float | None] | None
) -> list[str]:
    """Means over the joints that turn as text, or over slides if all slide: one over both would mean nothing."""
    slides = joint_slides(document)
    kept = [j for j, slid in enumerate(slides) if not slid or all(slides)]
    means = [_mean([column[j] for j in kept] if column else None) for column in columns]
    shown = _angles(*[[mean] for mean in means], unit="m" if all(slides) else "rad")
    return [texts[0] for texts in shown]


def _motions(slides: list[bool], *columns: list[float | None]) -> list[list[str]]:
    """Columns of angles [rad] and, of joints that slide, distances [m] as text."""
    shown = [[MISSING] * len(slides) for _ in columns]
    for sliding, unit in ((False, "rad"), (True, "m")):
        places = [j for j, slid in enumerate(slides) if slid == sliding]
        own = _angles(*[[column[j] for j in places] for column in columns], unit=unit)
        for row, texts in zip(shown, own, strict=True):
            for j, text in zip(places, texts, strict=True):
                row[j] = text
    return shown


def _angles(*columns: list[float | None], unit: str = "rad") -> list[list[str]]:
    """Columns of angles [rad], or of another unit, as text, all in the one unit that suits the largest."""
    factor, unit = display_unit(
        unit,
        max((value for column in columns for value in column if value), default=0.0),
    )
    name = unit if unit == "°" else f" {unit}"
    return [
        [
            MISSING if value is None else significant(factor * value, 2) + name
            for value in column
        ]
        for column in columns
    ]
