"""The document of a diagnosis: its content, its context, and the check of both."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.display import effect_name
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.json_file import field as schema_field
from gapscope.arm.io.json_file import plain, read_json, schema_fault, write_json
from gapscope.arm.nominal import NominalArm, arm_entry
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import rms
from gapscope.diagnosis.assessment.held_out_prediction import Rejection
from gapscope.diagnosis.assessment.predictable_share import Predictable, predictable
from gapscope.diagnosis.assessment.sensor_sides import sides_entry
from gapscope.diagnosis.document.expected import expected_entries
from gapscope.diagnosis.document.findings import (
    GapStages,
    effect_findings,
    known_numbers,
    numbers,
    possible_findings,
    region_entry,
    states_entry,
    suggested_recording,
    with_faults,
    with_states,
    with_torques_turned,
)
from gapscope.diagnosis.document.wording import misread, verdict, with_slide_units
from gapscope.diagnosis.gap.commanded_torque import WARNING
from gapscope.diagnosis.gap.plausible_data import short_note, still_note
from gapscope.diagnosis.gap.repeatability import repeatability
from gapscope.diagnosis.locate import MotionRows, located, stack
from gapscope.diagnosis.selection.evidence import Fit
from gapscope.diagnosis.selection.fitted_model import Selection
from gapscope.diagnosis.selection.search import WORSE
from gapscope.diagnosis.setup_faults.detection import upright
from gapscope.diagnosis.study import Study
from gapscope.diagnosis.thresholds import (
    INERTIAL_ERROR,
    PREDICTABLE_SHARE,
    SIGNIFICANT_RESIDUAL_RATIO,
)
from gapscope.effects.effect import SHEET
from gapscope.model.change_findings import change_findings
from gapscope.model.conditioning import TORQUE_CUTOFF
from gapscope.model.terms import Term
from gapscope.model.torque_gap import torque_scale
from gapscope.model_audit.audit import odd_kinds

# Context of the findings in ``diagnosis.json``: arm, recordings, conditioning, warnings.


def context(study: Study) -> dict[str, Any]:
    """The arm, the recordings, how they were conditioned, what was noticed, and what was considered."""
    case = study.case
    notes = [
        f"{recording.name}: {note}"
        for recording in (*case.recordings, *case.judged)
        for note in recording.notes
    ]
    inferred = WARNING in case.warnings
    return {
        "arm": arm_entry(case.arm),
        "nominal": {"friction": nominal_friction(case.arm)},
        "presliding": study.selection.presliding_of(study.selection.fit.terms).tolist(),
        "recordings": [
            *(recording_entry(r, "fit") for r in case.recordings),
            *(recording_entry(r, "judge") for r in case.judged),
        ],
        "conditioning": {
            "rate": study.predictor.segments[0].motion.rate,
            "position_cutoff": study.position_cutoff,
            "torque_cutoff": TORQUE_CUTOFF,
            "how": "zero-phase Butterworth, order 4, on both sides; positions cut at twice the frequency where their "
            "spectrum meets its noise; floor from the gap's power density above the band, timing and form of friction",
            "nominal_inertials_std": study.selection.sheet_error,
            "sampling_skew": study.selection.evidence.skew,
        },
        "judged_on": _judged_on(study, inferred),
        "torque_from": "controller" if inferred else "recorded",
        "warnings": [
            *case.warnings,
            *still_note(case),
            *short_note(case),
            *notes,
            *study.replay_gap.warnings,
        ],
        "considered": [
            *(_rejection_entry(rejection) for rejection in study.rejections),
            *_runners_up(study.selection),
        ],
    }


def nominal_friction(arm: NominalArm) -> dict[str, Any]:
    """The friction that the nominal arm has, and where it comes from."""
    return {
        "source": arm.friction_source or None,
        "coulomb": arm.coulomb.tolist(),
        "viscous": arm.viscous.tolist(),
    }


def recording_entry(recording: Recording, role: str) -> dict[str, Any]:
    """A recording, and whether effects are fitted to it or judged on it."""
    entry = {
        "name": recording.name,
        "duration": recording.duration,
        "rate": recording.rate,
        "role": role,
    }
    if recording.payload is not None:
        entry["payload"] = recording.payload.entry()
    return entry


def _judged_on(study: Study, inferred: bool) -> str:
    """On which data the gaps are measured, in words; ``inferred``: the torque is not recorded but computed."""
    if study.predictor.set_aside:
        text = "recordings set aside for judging"
    elif len(study.case.recordings) > 1:
        text = "halves of recordings, each predicted with values fitted to the rest"
    else:
        text = "blocks of the one recording, each half of one predicted with values fitted to the rest"
    if inferred:
        text += "; the torque there is the one that the known controller must have commanded"
    return text


def _rejection_entry(rejection: Rejection) -> dict[str, Any]:
    return {
        "effect": next(iter(rejection.terms)).effect,
        "joints": _joints(rejection.terms),
        "log_evidence": None,
        "gap_closed": -rejection.cost,
        "reason": rejection.reason,
    }


def _runners_up(selection: Selection) -> list[dict[str, Any]]:
    """The effects that the search weighed beside what it found, or in the place of one, each in its likeliest set."""
    out: dict[str, dict[str, Any]] = {}
    mine, evidence = selection.fit.terms, selection.evidence
    here = _nrmse(selection, selection.fit)
    for terms, value in sorted(selection.competing.items(), key=lambda e: -e[1]):
        more, less = terms - mine, mine - terms
        names, places = {t.effect for t in more}, {t.finding for t in less}
        if len(names) != 1 or len(places) > 1 or not more <= set(evidence.terms.all):
            continue
        (name,) = names
        closed_more = here - _nrmse(selection, evidence.fit(terms))
        if places:
            reason = f"{effect_name(next(iter(less)).effect)} explains more"
        elif value > 0:
            reason = "it closes too little of the gap for a person to see"
        else:
            reason = "what it explains is not worth one more effect"
        entry = {
            "effect": name,
            "joints": _joints(more),
            "log_evidence": value,
            "gap_closed": float(closed_more.sum()),
            "reason": reason,
        }
        out.setdefault(name, entry)
    return list(out.values())


def _nrmse(selection: Selection, fit: Fit) -> np.ndarray:
    """Held-out torque NRMSE with the terms of a fit over all folds, (n,)."""
    rows = selection.evidence.rows
    mean_square = (fit.held_out_mse * rows).sum(axis=0) / rows.sum(axis=0)
    return np.asarray(np.sqrt(mean_square) / selection.scale)


def _joints(terms: frozenset[Term]) -> list[int]:
    """Joints of terms on joints; none of those on a link or the arm."""
    return sorted(t.joint for t in terms if t.definition.scope == "joint")


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


# The content of ``diagnosis.json``, put together from a study of a case.


def diagnosis_content(study: Study) -> dict[str, Any]:
    """``diagnosis.json`` of a study, without NaN, as plain Python values."""
    gap = _gap_stages(study)
    rows = stack(study.predictor.segments)
    named = with_torques_turned(effect_findings(study, rows), study.case.arm.n_joints)
    here = with_faults(named, study.faults, gap)
    effects = with_states(here, study.states, study.terms, study.theta)
    possible = possible_findings(study, rows)
    open_joints = [int(j) + 1 for j in np.flatnonzero(study.excess_residual.above)]
    predictions = predictable(study.gap_after, rows, study.floor, open_joints)
    reach = partial(
        verdict,
        explained=_explained(study, gap),
        significant=_significant(study, predictions),
        rejected=bool(study.rejections),
    )
    reached = reach(found=bool(effects or study.changes))
    # where the arm was diagnosed nothing need be missing
    closed = gap.closed if reach(found=bool(here)) == reached else None
    # what stays on a joint is worth a recording only where the verdict says that it is unexplained
    unexplained = open_joints if reached == "unexplained" else []
    doubt, first = _misread(study) if reached == "unexplained" else ("", "")
    another = {"misread": doubt} if study.another_arm else {}
    content: dict[str, Any] = {
        "schema": 1,
        "case": study.case.name,
        "verdict": reached,
        **another,
        "gap": _gap_entry(study, gap),
        "effects": effects,
        "possible": possible,
        "changes": change_findings(study.changes),
        **states_entry(study.states.found),
        "closed": closed,
        "unexplained": {
            "share": 0.0 if closed is None else 1.0 - closed,
            "above_floor": bool(unexplained),
            **_unexplained_entry(study, rows, open_joints, predictions),
        },
        "next_recording": suggested_recording(
            reached,
            effects,
            possible,
            unexplained,
            study.undeclared_coupling,
            first,
        ),
        "where": _where_before(study, rows, gap),
        "expected": expected_entries(study.selection.further),
    }
    if study.sensor_sides is not None:
        content["sides"] = sides_entry(study.sensor_sides, effects)
    content |= context(study)
    odd = odd_kinds(study.case.arm.urdf) if reached == "unexplained" else ""
    if odd:
        # what is wrong in the file need not be looked for in the recordings
        note = f"in the robot file: {odd}; see gapscope audit {study.case.arm.urdf.resolve()}"
        content["warnings"].insert(0, note)
    if first and not another:
        content["warnings"].insert(0, f"{doubt}; {first}")
    off = study.selection.sheet_error
    if reached != "no_gap" and off > WORSE * INERTIAL_ERROR:
        content["warnings"].append(
            f"the bodies of the robot file seem to be off by about {off:.0%} of their size, which hides loads and "
            "changed links: identify them (gapscope identify), or compare with a reference (diagnose --against)"
        )
    return with_slide_units(content, study.case.arm.sliding)


def _misread(study: Study) -> tuple[str, str]:
    """What makes the nominal arm another one than was recorded, and what to do first; empty if nothing does."""
    off = float(np.sqrt((study.gap_before.nrmse**2).mean()))
    mounted = upright(study.case).arm
    return misread(
        off, mounted.gravity, study.case.arm.gravity, another=study.another_arm
    )


def _gap_stages(study: Study) -> GapStages:
    repaired = study.gap_before.nrmse
    recorded = [f.gap_before for f in study.faults if f.gap_before is not None]
    return GapStages(
        recorded=recorded[0] if recorded else repaired,
        repaired=repaired,
        corrected=study.gap_after.nrmse,
        floor=study.floor / torque_scale(study.gap_before.measured),
    )


def _explained(study: Study, gap: GapStages) -> bool:
    """Whether the residual is no more than may be left of the gap, with the set-up repaired or as it was given."""
    residual = study.excess_residual
    if not residual.open:
        return True
    # A repaired fault explains all that it took away: the residual is small beside the gap of the case as given.
    widened = any(fault.gap_before is not None for fault in study.faults)
    return widened and not residual.exceeds_explained_share_of(gap.recorded)


def _significant(study: Study, predictions: list[Predictable]) -> bool:
    """Whether the residual of some joint is far above the floor, or can be predicted."""
    ratio = study.excess_residual.ratio
    return study.another_arm or any(
        p.share >= PREDICTABLE_SHARE or ratio[p.joint - 1] >= SIGNIFICANT_RESIDUAL_RATIO
        for p in predictions
    )


def _gap_entry(study: Study, gap: GapStages) -> dict[str, Any]:
    replay = study.replay_gap
    elsewhere_before, elsewhere_after = {}, {}
    for engine, (before, after) in replay.elsewhere.items():
        elsewhere_before[engine] = known_numbers(before)
        elsewhere_after[engine] = known_numbers(after)
    return {
        "replayed": replay.by,
        "engine": replay.engine,
        "before": {
            "torque_nrmse": numbers(gap.recorded),
            "replay_rmse": known_numbers(replay.before),
            "replay_elsewhere": elsewhere_before,
            "floor": numbers(gap.floor),
        },
        "after": {
            "torque_nrmse": numbers(gap.corrected),
            "replay_rmse": known_numbers(replay.after),
            "replay_elsewhere": elsewhere_after,
        },
        "repeatability": _repeatability_entry(study),
    }


def _repeatability_entry(study: Study) -> dict[str, Any] | None:
    """What the arm's own repeats differ by, and how many times that the gap is; ``None`` without repeats."""
    gap = study.gap_after
    rates = [segment.motion.rate for segment in study.predictor.segments]
    found = repeatability(gap, rates, study.floor)
    if found is None:
        return None
    nrmse = found.rms / torque_scale(gap.measured)
    return {
        "torque_nrmse": numbers(nrmse),
        "seconds": found.seconds,
        "times": float(rms(gap.nrmse) / rms(nrmse)),
    }


def _unexplained_entry(
    study: Study,
    rows: MotionRows,
    open_joints: list[int],
    predictions: list[Predictable],
) -> dict[str, Any]:
    return {
        "joints": open_joints,
        "times_floor": numbers(study.excess_residual.ratio),
        "where": _where(study, study.gap_after.error, rows, open_joints),
        "predictable": [p.document() for p in predictions],
        "coupling": _coupling_entry(study),
    }


def _coupling_entry(study: Study) -> dict[str, Any] | None:
    """Two joints that seem to be turned by one motor, and the coupling to declare; ``None`` if no two do."""
    found = study.undeclared_coupling
    if found is None:
        return None
    return {
        "joints": [found.joint, found.motor],
        "declare": found.declaration,
        "log_evidence": found.gain,
    }


def _where_before(
    study: Study, rows: MotionRows, gap: GapStages
) -> list[dict[str, Any]]:
    """Where the gap of the nominal arm lies, on joints where it is above the floor, the widest first."""
    nrmse = gap.repaired
    joints = [int(j) + 1 for j in np.argsort(-nrmse) if nrmse[j] > gap.floor[j]]
    return _where(study, study.gap_before.error, rows, joints)


def _where(
    study: Study, error: np.ndarray, rows: MotionRows, joints: list[int]
) -> list[dict[str, Any]]:
    """Regions in which a gap [N m], (M, n), is concentrated."""
    load = study.gap_before.predicted
    places = located(error, rows, load, study.floor, joints)
    return [region_entry(region) for region in places]
