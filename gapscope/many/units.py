"""The section of a report that compares units of one type, and its tables on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from math import log
from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from gapscope.arm.display import (
    MISSING,
    display_unit,
    effect_name,
    listing,
    nrmse,
    percent,
    uncertain,
)
from gapscope.diagnosis.compare_units import (
    DIFFERING,
    NOMINAL,
    ONE,
    SHARED,
    SOME,
    is_of,
)
from gapscope.diagnosis.document.wording import Document, capital, joint_ranges
from gapscope.diagnosis.thresholds import ALIKE_NRMSE, FLEET_LEVEL
from gapscope.effects.catalogue import known_effect
from gapscope.model.changes import named_text, size_text
from gapscope.reports.diagnosis import ADDING
from gapscope.reports.pages import PageSection, terminal_table

# The comparison of units as a person reads it: ``units.json`` in words, for the summary and the terminal.


MEANING = {
    SHARED: "the model of this type of arm lacks it",
    DIFFERING: "the model of this type of arm lacks it; each unit has its own size",
    SOME: "several units have it, not all",
    ONE: "this unit differs from the others",
}
ALIKE = "named here alone; others may have it as well, too small to be named"
OWN = "What a unit has of its own, beside what all share"
OWN_HEAD = ("unit", "effect", "size", "probability")
_SHEET = {"urdf": "URDF", "torque_limit": "torque limits"} | {
    key: effect_name(effect.name) for key, effect in ADDING.items()
}


TOLERANCE = f"or worse by less than {ALIKE_NRMSE:g} NRMSE on every joint"


def findings(group: Document) -> Sequence[Document]:
    """Effects of a group, places with one answer together, in words.

    Returns:
        Of each effect ``name``, ``place``, ``kind`` as in ``units.json``, ``label`` (the kind in words), ``meaning``
        (what follows from it), ``notes`` (units that have it under another name) and ``lines`` (its numbers).
    """
    alike: dict[tuple[Any, ...], list[Document]] = {}
    for row in group["effects"]:
        # alike in all but the joint: one line for several joints
        same = [row[key] for key in ("effect", "kind", "agree", "link")]
        key = (*same, *row["units"], *row["instead"].items())
        alike.setdefault(key, []).append(row)
    # joints of one answer are one line of the report
    made, n = [], len(group["units"])
    for rows in alike.values():
        rows.sort(key=lambda row: row["joint"] or 0)
        first, joints = rows[0], [row["joint"] for row in rows if row["joint"]]
        plural = "s" if len(joints) > 1 else ""
        link = f"link {first['link']}" if first["link"] else "the whole arm"
        size = "alike" if first["agree"] else "sizes differ"
        label = {
            SHARED: f"on all {n} units, alike",
            DIFFERING: f"on all {n} units, sizes differ",
            SOME: f"on {len(first['units'])} of {n} units, {size}",
            ONE: f"only on {first['units'][0]}",
        }[first["kind"]]
        notes = [
            f"{unit} has {effect_name(other)} in its place"
            for unit, other in first["instead"].items()
        ]
        # small effects are named of some units, and missed on others that have them as well
        own, alone = group["differences"], first["kind"] in (SOME, ONE)
        told = own is None or any(is_of(other, row) for other in own for row in rows)
        meaning = ALIKE if alone and not told else MEANING[first["kind"]]
        made.append(
            {
                "name": capital(effect_name(first["effect"])),
                "place": f"joint{plural} {listing(joint_ranges(joints))}"
                if joints
                else link,
                "kind": first["kind"],
                "label": label,
                "meaning": meaning,
                "notes": notes,
                "lines": [
                    _line(group["units"], row, value)
                    for row in rows
                    for value in row["parameters"]
                ],
            }
        )
    return made


def _line(units: Sequence[str], row: Document, value: Document) -> Document:
    """One number of an effect: ``label``, ``entries`` by unit, ``together``, ``scatter``, whether it ``differs``."""
    definition = known_effect(row["effect"])
    # what adds to the nominal arm shows its sign
    signed = definition is not None and any(
        p.increment and p.name == value["name"] for p in definition.parameters
    )
    # one prefix for the values of all units
    largest = max(abs(v) for v in value["value"].values())
    factor, unit = display_unit(value["unit"], largest)

    def text(x: float, std: float | None) -> str:
        return uncertain(factor * x, None if std is None else factor * std, signed)

    together = value["together"]
    label = (
        f"J{row['joint']}" if row["joint"] else "",
        value["name"].replace("_", " "),
        value["component"],
        f"[{unit}]" if unit else "",
    )
    # the level of the test by which units were said to differ
    level = FLEET_LEVEL / len(row["parameters"])
    return {
        "label": " ".join(filter(None, label)),
        "entries": [
            text(value["value"][u], value["std"][u]) if u in value["value"] else MISSING
            for u in units
        ],
        "together": text(together["estimate"], together["std"])
        if together
        else MISSING,
        "scatter": percent(together["i_squared"]) if together else MISSING,
        "differs": bool(together) and together["p"] < level,
    }


def own_rows(group: Document) -> list[tuple[str, str, str, str]]:
    """What units have of their own: unit, effect and place, size, probability."""
    return [
        (
            entry["unit"],
            capital(named_text(entry)),
            size_text(entry),
            percent(entry["probability"]),
        )
        for entry in group["differences"] or ()
    ]


def heading(group: Document) -> str:
    """How many effects the units of a group share, in one sentence."""
    kinds = [finding["kind"] for finding in findings(group)]
    words = {
        SHARED: "shared by all units",
        DIFFERING: "shared in differing size",
        SOME: "on some units",
        ONE: "on one unit alone",
    }
    parts = [
        f"{kinds.count(kind)} {text}" for kind, text in words.items() if kind in kinds
    ]
    if not parts:
        return "No effect was found on any of them."
    # worth saying: then the model of the type lacks nothing
    none = "" if {SHARED, DIFFERING} & set(kinds) else "none is shared by all units; "
    return f"Effects found: {none}{listing(parts)}."


def nominal_note(group: Document) -> str:
    """Note on different nominal arms of the cases; empty if they are the same."""
    differs = [_SHEET.get(key, key) for key in group["nominal_differs"]]
    if not differs:
        return ""
    return (
        f"The cases give these units different nominal arms ({listing(differs)}). Each value is on top of its own "
        "case's, so values that agree need not mean equal totals, and units are told apart by their cases, too: give "
        "all units of one type the same URDF and data sheet."
    )


def cells(confusion: Document) -> list[tuple[str, list[Document]]]:
    """The confusion row by row with its label.

    Each cell has its ``value`` (NRMSE), ``heat`` from 0 to 1 on a logarithmic scale, and whether it is of the unit's
    ``own`` arm, and of the ``best``.
    """
    lines = confusion["torque_nrmse"]
    # zero has no logarithm
    known = [v for line in lines for v in line if v is not None and v > 0]
    low, high = (min(known), max(known)) if known else (1.0, 1.0)

    def cell(row: str, unit: str, value: float | None) -> Document:
        heat = log(value / low) / log(high / low) if value and high > low else 0.0
        # one of each column: the arm that predicts this unit best
        best = row == confusion["best"][unit]
        return {"value": value, "heat": heat, "own": row == unit, "best": best}

    return [
        (
            row,
            [cell(row, u, v) for u, v in zip(confusion["columns"], line, strict=True)],
        )
        for row, line in zip(confusion["rows"], lines, strict=True)
    ]


def row_label(row: str) -> str:
    """Label of a row of the confusion."""
    return "nominal arm" if row == NOMINAL else f"corrected arm of {row}"


def told_apart(confusion: Document) -> list[str]:
    """What the confusion says, in sentences; units that are all confused with each other in one."""
    confused = {
        unit: [unit, *confusion["confused_with"][unit]] for unit in confusion["columns"]
    }
    mixed = {unit: set(own) for unit, own in confused.items() if len(own) > 1}
    if confused and not mixed:
        return [
            "Every unit is predicted best by its own corrected arm: they can be told apart."
        ]
    out = []
    for unit, others in mixed.items():
        # one-sided: an arm may predict another unit that does not predict it
        if any(mixed.get(other) != others for other in others):
            names, several = confused[unit][1:], len(others) > 2
            their = (
                "their corrected arms predict"
                if several
                else "its corrected arm predicts"
            )
            out.append(
                f"{unit} cannot be told from {listing(names)}: {their} {unit} as well as its own does ({TOLERANCE})."
            )
            continue
        # a group is told once, at its first unit
        names = [other for other in confused if other in others]
        if unit == names[0]:
            more = "s" if len(names) > 2 else ""
            out.append(
                f"{listing(names)} cannot be told apart: the corrected arm of one predicts the other{more} as well as "
                f"their own ({TOLERANCE})."
            )
    return out


# The comparison of units as tables on the terminal.


def fleet_tables(content: Document) -> Group:
    """The content of ``units.json``: per type of arm the effects with the units that have them, and the confusion."""
    parts: list[RenderableType] = []
    for group in content["groups"]:
        confusion = group["confusion"]
        # effects of a group and the units that have them
        rows = [
            (found["name"], found["place"], f"{found['label']}: {found['meaning']}")
            for found in findings(group)
        ]
        title = f"{group['robot']}, {len(group['units'])} units"
        table = PageSection(title, ("effect", "on", "found"), rows)
        said = table.on_terminal(caption=heading(group), caption_justify="left")
        parts.append(said)
        if group["differences"]:
            own = PageSection(OWN, OWN_HEAD, own_rows(group))
            parts.append(own.on_terminal())
        if confusion["columns"]:
            # mean torque NRMSE of each arm on the recordings of each unit; the least of each column in bold
            lines = []
            for row, line in cells(confusion):
                values = (
                    Text(nrmse(c["value"]), "bold" if c["best"] else "") for c in line
                )
                lines.append([Text(row_label(row)), *values])
            title = "torque NRMSE of an arm (row) on the recordings of a unit (column)"
            parts.append(
                terminal_table(["", *confusion["columns"]], lines, title=title)
            )
        # after the table that they explain
        notes = (*told_apart(confusion), nominal_note(group))
        parts += [Text(note) for note in notes if note]
    return Group(*parts)
