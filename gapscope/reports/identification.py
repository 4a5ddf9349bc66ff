"""An identification as a page, on the terminal and as files."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from rich.console import Group
from rich.text import Text

from gapscope.arm.io.atomic_write import write_text
from gapscope.arm.io.json_file import plain, write_document
from gapscope.arm.joint_units import common_unit
from gapscope.arm.root_mean_square import rms
from gapscope.diagnosis.document.wording import Document, joint_slides
from gapscope.effects.corrected_file import write_corrected
from gapscope.ident.identification import (
    FOUND,
    WORSE,
    Identification,
    Validation,
)
from gapscope.ident.identification_json import (
    document,
    effects,
    filter_document,
    identified_bodies,
    presliding,
    with_sheet,
    write_base,
    write_case_beside,
)
from gapscope.ident.kalman import FilterReview
from gapscope.ident.model.base_parameters import CONDITION_LIMIT
from gapscope.ident.model.physical_parameters import urdf_text
from gapscope.model.changes import change_findings, change_text
from gapscope.reports.diagnosis import encode, keep_extremes
from gapscope.reports.pages import terminal_table, write_html

# An identification as a page and on the terminal.


# The section on the Kalman filter: a sentence, the innovations per joint, and curves of the estimates over time.


FILTER_POINTS = 1500
"""Most points of the innovations of one joint."""


def filter_sentence(document: Document) -> str:
    """What the filter did, in words, from the document of the identification."""
    shown = document["filter"]
    whole = shown["elapsed"][-1]
    parts = [f"does not converge in {whole:.3g} s"]
    if shown["converged"] is not None:
        parts = [f"converges after {shown['converged']:.3g} s of {whole:.3g} s"]
    # zero: parameters are held constant
    level = shown["process_noise"]
    wander = (
        f"friction wanders by {100 * level:.2g} % in a second" if level else "no drift"
    )
    parts.append(wander)
    unlike = [
        j for j, white in enumerate(shown["innovations"]["white"], 1) if not white
    ]
    joints = ", ".join(map(str, unlike))
    parts.append(
        f"innovations not white on joint {joints}" if unlike else "white innovations"
    )
    count = len(shown["departures"])
    departs = "no parameter departs from the batch"
    if count:
        # the farthest comes first
        worst = shown["departures"][0]
        departs = (
            f"{count} of {len(shown['parameters'])} parameters depart from the batch, {worst['expression']} farthest "
            f"at {worst['time']:.3g} s of {worst['recording']}"
        )
    return "; ".join((*parts, departs))


def filter_curves(result: Identification) -> Document:
    """What the figures draw: each parameter with its band and the batch, and each joint's innovations."""
    review = result.filtered
    track = review.track
    expressions = result.base.expressions()
    names = list(result.base.kept_names)
    nominal = result.base.of(result.columns.nominal(result.choice.law))
    parameters = [
        {
            "name": names[i],
            "expression": expression,
            "value": encode(track.value[:, i]),
            "std": encode(track.deviation[:, i]),
            "batch": float(review.batch[i]),
            "nominal": float(nominal[i]),
        }
        for i, expression in enumerate(expressions)
    ]
    # an index of the track, or none
    start = review.converged

    def elapsed(recording: str, time: float) -> float:
        """Elapsed time of a moment of a recording [s], each of which has a clock of its own."""
        own = np.array([name == recording for name in review.recordings])
        return float(np.interp(time, review.times[own], track.t[own]))

    # each joint's innovations over the elapsed time
    t = np.cumsum(review.problem.interval) - review.problem.interval[0]
    joints = []
    for series in review.innovation.T:
        keep = keep_extremes([series], FILTER_POINTS)
        joints.append({"t": encode(t[keep]), "value": encode(series[keep])})
    return {
        "elapsed": encode(review.track.t),
        "parameters": parameters,
        "first": _first(review, names),
        "innovations": joints,
        "converged": None if start is None else float(review.track.t[start]),
        # moments of the changes in elapsed time, in words
        "changes": [
            {
                "elapsed": elapsed(entry["recording"], entry["time"]),
                "text": change_text(entry),
            }
            for entry in change_findings(review.changes)
        ],
        # recordings after the first begin where the one before ends
        "starts": [
            {"elapsed": float(t), "name": name}
            for t, before, name in zip(
                track.t, review.recordings, review.recordings[1:], strict=False
            )
            if name != before
        ],
    }


def _first(review: FilterReview, names: list[str]) -> int:
    """The parameter that is drawn at first: one that changed, or that departs, or friction of the first joint."""
    for moved in review.moved:
        # of the first change, by what each parameter moved over its deviation
        return int(np.abs(moved / review.track.deviation[-1]).argmax())
    if review.departures:
        return review.departures[0].parameter
    # names begin with b, viscous, and c, Coulomb
    friction = [i for i, name in enumerate(names) if name[0] in "bc"]
    return friction[0] if friction else 0


# What the figures draw: torque over time and the residual over speed, as base64 of float32.


POINTS = 3000
"""Most points of one curve over time."""
DOTS = 1200
"""Most points of one cloud."""
FLOOR = 1e-8
"""Where the spectrum ends at the bottom [1]."""


def payload(result: Identification) -> Document:
    """All that the script of the report draws, as JSON-ready values."""
    names = result.case.arm.joints
    judged = result.validation[1]
    # a joint without any torque has no relative error
    worst = int(np.nanargmax(judged.every.relative))
    groups = [
        _group(validation, a, b, k)
        # what was held out comes first
        for validation in result.validation[::-1]
        for k, (a, b) in enumerate(pairwise(validation.edges), 1)
    ]
    # what a partial update did to each base parameter, as torque [N m]: it leaves some where they were
    update = []
    if result.moved is not None:
        nominal = result.base.of(result.columns.nominal(result.choice.law))
        # parameters have different units: each counts by the torque that its column makes
        size = rms(result.problem.matrix, axis=(0, 1))
        columns = {
            "name": np.array(result.estimate.names),
            "change": (result.estimate.value - nominal) * size,
            "std": result.uncertainty.deviation * size,
            "moved": result.moved,
        }
        rows = zip(*(own.tolist() for own in columns.values()), strict=True)
        update = [dict(zip(columns, row, strict=True)) for row in rows]
    return {
        "joints": [f"J{j + 1} {name}" for j, name in enumerate(names)],
        "worst": worst,
        "slides": list(result.case.arm.sliding),
        "groups": groups,
        # a logarithmic axis has no zero
        "spectrum": [
            float(x) for x in np.maximum(result.determined.singular_values, FLOOR)
        ],
        "limit": 1 / CONDITION_LIMIT,
        "filter": filter_curves(result),
        "update": update,
    }


def _group(validation: Validation, a: int, b: int, number: int) -> Document:
    """One segment: per joint the curves over time, and the residual over the speed."""
    joints = []
    t = validation.t[a:b]
    for j in range(validation.torque.shape[1]):
        torque, predicted, before, speed = (
            x[a:b, j]
            for x in (
                validation.torque,
                validation.predicted,
                validation.before,
                validation.velocity,
            )
        )
        # peaks of the torque and of what is left
        keep = keep_extremes([torque, torque - predicted], POINTS)
        dots = np.unique(np.linspace(0, b - a - 1, min(b - a, DOTS)).astype(int))
        joints.append(
            {
                "t": encode(t[keep]),
                "recorded": encode(torque[keep]),
                "identified": encode(predicted[keep]),
                "nominal": encode(before[keep]),
                "speed": encode(speed[dots]),
                "left": encode((torque - predicted)[dots]),
            }
        )
    role = {"fit": "fitted", "judge": "unseen"}[validation.role]
    names = ", ".join(validation.recordings)
    return {
        "name": f"{names}, part {number} ({role})"
        if len(validation.edges) > 2
        else f"{names} ({role})",
        "joints": joints,
    }


# What the tables of the report say, made of the document alone.


_FRICTION = (
    ("I", "rotor inertia", "kg m^2"),
    ("b", "viscous", "N m s/rad"),
    ("c", "Coulomb", "N m"),
    ("d", "Stribeck", "N m"),
    ("s", "saturating", "N m"),
    ("o", "offset", "N m"),
)


def friction(document: Document) -> Document:
    """Rotor inertia, friction and offset: a column each, a row per joint and coupled motor."""
    # names are a symbol and a joint: b4, or of a coupled motor b6m
    found = {p["name"]: p for p in document["parameters"]}
    labels = [str(j + 1) for j in range(len(document["arm"]["joints"]))]
    motors = (name for name in found if name[0] in "Ibcd" and name.endswith("m"))
    labels += sorted({name.lstrip("Ibcd") for name in motors})
    # columns that some row fills
    shown = [
        column
        for column in _FRICTION
        if any(f"{column[0]}{label}" in found for label in labels)
    ]
    slides = joint_slides(document)
    return {
        "columns": [
            (symbol, name, common_unit(unit, slides)) for symbol, name, unit in shown
        ],
        "rows": [
            (label, [found.get(f"{symbol}{label}") for symbol, *_ in shown])
            for label in labels
        ],
    }


# Renders an identification into one self-contained HTML file, in the style of the diagnosis.


def render(result: Identification, document: Document, path: Path | str) -> None:
    """Write the report; the file loads nothing from elsewhere.

    Args:
        result: what was identified, for the curves.
        document: its document, for the tables.
        path: of the file.

    Raises:
        GapscopeError: ``path`` cannot be written.
    """
    content = plain(document, null_if_not_finite=True)
    slides, judged = joint_slides(content), content["validation"][1]
    errors = [*judged["nominal"]["relative"], *judged["every"]["relative"]]
    write_html(
        "identification/report.html",
        path,
        curves=payload(result),
        document=content,
        # a joint without any torque has no relative error
        scale=max(filter(None, errors), default=1.0),
        friction=friction(content),
        force=common_unit("N m", slides),
        speed_force=common_unit("N m s/rad", slides),
        found=FOUND,
        filter_sentence=filter_sentence(content),
    )


# An identification on the terminal: errors per joint, what was fitted and found, questions and warnings.


MAX_WARNING = 160
"""Longest warning [characters]; the report has all of it."""
MAX_NAMES = 3
"""Most recordings that are named one by one."""


def summary(result: Identification) -> Group:
    """The table of errors per joint, and lines on what was fitted, found, asked, and what is doubtful.

    Before them, if the nominal arm predicts what was held out better, that it does.
    """
    found = [row for row in result.table if row.verdict == FOUND]
    # what a row says already is not said twice
    said = tuple(row.cause for row in found)
    warnings = [text for text in result.warnings if not text.startswith(said)]
    lines = [
        *_facts(result),
        *(f"asks: {question}" for question in result.questions),
        *(f"found: {row.cause}{_on_joints(row.joints)}" for row in found),
        *(f"warning: {shortened(warning)}" for warning in warnings),
    ]
    first = [f"warning: {text}" for text in warnings if text.startswith(WORSE)]
    # this one stands above the table
    rest = [line for line in lines if WORSE not in line]
    # relative error of the torque per joint, before and after, on fitted and held-out samples
    fit, held_out = result.validation
    shown = {
        "nominal, held out": held_out.nominal,
        "fitted": fit.every,
        "held out": held_out.every,
        "held out, moving": held_out.moving,
    }
    rows = [
        [label, *map(_percent, errors.relative), _percent(errors.overall)]
        for label, errors in shown.items()
    ]
    numbers = range(1, result.case.arm.n_joints + 1)
    title = f"RMS residual over RMS torque of {result.case.name} [%]"
    heads = ["", *(f"J{number}" for number in numbers), "all"]
    style = {"title": title, "padding": (0, 0, 0, 1)}
    table = terminal_table(heads, rows, 1, slice(1), **style)
    return Group(*map(Text, first), table, *map(Text, rest))


def _facts(result: Identification) -> list[str]:
    """Which recordings were fitted and held out, and the size and condition of the problem."""
    fit, held_out = result.validation
    base, cutoff = result.base, result.settings.cutoff
    moved = () if result.moved is None else (_moved(result, result.moved),)
    document = {"filter": filter_document(result.filtered, base.expressions())}
    return [
        f"fitted {_named(fit.recordings)}; held out {_named(held_out.recordings)}",
        f"{base.count} base parameters of {len(base.names)}, condition number {result.condition:.3g}; "
        f"friction: {result.choice.law}; cut-off {cutoff:.3g} Hz",
        *moved,
        f"Kalman filter: {filter_sentence(document)}",
    ]


def _moved(result: Identification, moved: np.ndarray) -> str:
    """Which base parameters a partial update moved."""
    names = [n for n, m in zip(result.estimate.names, moved, strict=True) if m]
    which = f": {', '.join(names)}" if names else ""
    return shortened(
        f"partial update: {len(names)} of {len(moved)} base parameters moved, the others stay nominal{which}"
    )


def shortened(warning: str) -> str:
    """The first clauses of a warning, as many as ``MAX_WARNING`` characters hold, or words of the first clause."""
    first, *others = warning.split("; ")
    kept = first
    # whole clauses: half a sentence says something else
    for clause in others:
        if len(kept) + 2 + len(clause) > MAX_WARNING:
            break
        kept = f"{kept}; {clause}"
    return textwrap.shorten(kept, MAX_WARNING, placeholder=" ...")


def _named(recordings: Sequence[str]) -> str:
    """Names of recordings, or how many there are."""
    if len(recordings) <= MAX_NAMES:
        return ", ".join(recordings)
    return f"{len(recordings)} recordings, {recordings[0]} first"


def _on_joints(joints: tuple[int, ...]) -> str:
    return f", joint {', '.join(map(str, joints))}" if joints else ""


def _percent(value: float) -> str:
    # only nan differs from itself
    is_nan = value != value
    return "–" if is_nan else f"{100 * value:.1f}"


# An identification as files: report, document, and the identified arm as a case that other commands read.


DOCUMENT, REPORT, EFFECTS = "identification.json", "report.html", "identified.yaml"
CASE, URDF, BASE = "identified_case.yaml", "identified.urdf", "base_parameters.npz"
FILES = {
    "report": REPORT,
    "urdf": URDF,
    "case": CASE,
    "effects": EFFECTS,
    "base": BASE,
}
"""What is written beside the document, by purpose."""


def write_identification(
    result: Identification,
    case_file: Path,
    folder: Path,
) -> tuple[Path, ...]:
    """Write report, identified arm and, as the last, ``identification.json``.

    The identified arm is a URDF of consistent bodies, a case beside it with the data sheet, and ``identified.yaml``
    with the effects that the catalogue has: ``predict``, ``replay`` and ``gap`` read the case with that as model.

    Args:
        result: what was identified.
        case_file: the case file, whose recordings the new case names.
        folder: of the results.

    Raises:
        GapscopeError: no physically consistent parameters were found, or a file cannot be written.
    """
    # first what may fail: bodies that no arm can have
    text = urdf_text(result.case.arm, identified_bodies(result))
    write_text(folder / URDF, text)
    write_case_beside(with_sheet(result), case_file, folder / CASE, URDF)
    write_corrected(
        result.case.name,
        effects(result),
        folder / EFFECTS,
        presliding=presliding(result),
    )
    write_base(result, folder / BASE)
    content = document(result, FILES)
    render(result, content, folder / REPORT)
    # last: with it the results are whole
    write_document(content, folder / DOCUMENT, "identification")
    names = (REPORT, DOCUMENT, CASE, URDF, EFFECTS, BASE)
    return tuple(folder / name for name in names)
