"""What the tables of the report say, made of the document alone."""

from __future__ import annotations

from typing import Any

from gapscope.arm.display import MISSING, uncertain
from gapscope.arm.joint_units import common_unit
from gapscope.reports.pages import percent_with_decimal

_FRICTION = (
    ("I", "rotor inertia", "kg m^2"),
    ("b", "viscous", "N m s/rad"),
    ("c", "Coulomb", "N m"),
    ("d", "Stribeck", "N m"),
    ("s", "saturating", "N m"),
    ("o", "offset", "N m"),
)


def joint_slides(document: dict[str, Any]) -> list[bool]:
    """Whether each joint slides."""
    sliding, count = document["arm"].get("sliding", []), len(document["arm"]["joints"])
    return [joint in sliding for joint in range(1, count + 1)]


def heading(document: dict[str, Any]) -> dict[str, Any]:
    """Verdict as a label, and a sentence."""
    judged = document["validation"][1]
    asks = bool(document["questions"])
    count, total = document["base"]["count"], len(document["parameters"])
    return {
        "label": "A question first" if asks else "Identified",
        "badge": "unexplained" if asks else "effects_found",
        "sentence": (
            f"{count} base parameters of {total}. On samples that were not fitted the identified arm is off by "
            f"{percent_with_decimal(judged['every']['overall'])} of the torque, the nominal arm by "
            f"{percent_with_decimal(judged['nominal']['overall'])}."
        ),
        "unseen": judged["every"]["overall"],
        "moving": judged["moving"]["overall"],
        "fitted": document["validation"][0]["every"]["overall"],
        "nominal": judged["nominal"]["overall"],
    }


def joints(document: dict[str, Any]) -> dict[str, Any]:
    """Errors per joint on held-out samples, and the scale of their bars."""
    judged = document["validation"][1]
    rows = [
        {
            "label": f"J{j}",
            "name": name,
            "nominal": before,
            "identified": after,
            "moving": moving,
        }
        for j, (name, before, after, moving) in enumerate(
            zip(
                document["arm"]["joints"],
                judged["nominal"]["relative"],
                judged["every"]["relative"],
                judged["moving"]["relative"],
                strict=True,
            ),
            1,
        )
    ]
    known = [
        x for row in rows for x in (row["nominal"], row["identified"]) if x is not None
    ]
    return {"rows": rows, "scale": max(known, default=1.0) or 1.0}


def friction(document: dict[str, Any]) -> dict[str, Any]:
    """Rotor inertia, friction and offset: a column each, a row per joint and coupled motor."""
    found = {p["name"]: p for p in document["parameters"]}
    slides = joint_slides(document)
    labels = [str(j + 1) for j in range(len(document["arm"]["joints"]))]
    labels += sorted(
        {
            name.lstrip("Ibcd")
            for name in found
            if name.endswith("m") and name[0] in "Ibcd"
        }
    )
    shown = [
        entry
        for entry in _FRICTION
        if any(f"{entry[0]}{label}" in found for label in labels)
    ]
    rows = [
        {
            "label": f"J{label}" if not label.endswith("m") else f"motor {label[:-1]}",
            "cells": [_value(found.get(f"{symbol}{label}")) for symbol, _, _ in shown],
        }
        for label in labels
    ]
    return {
        "columns": [
            {
                "symbol": s,
                "name": name,
                "unit": common_unit(unit, slides).replace("^2", "²"),
            }
            for s, name, unit in shown
        ],
        "rows": rows,
    }


def _value(parameter: dict[str, Any] | None) -> dict[str, str]:
    if parameter is None:
        return {"text": MISSING, "status": ""}
    return {
        "text": uncertain(parameter["value"], parameter["std"]),
        "status": parameter["status"],
    }


def links(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Per link mass, moments and checks, with how many of its ten parameters were recovered."""
    parameters = document["parameters"]
    out = []
    for k, link in enumerate(document["links"]):
        own = parameters[10 * k : 10 * k + 10]
        out.append(
            link
            | {
                "nominal": own[0]["nominal"],
                "recovered": sum(p["status"] == "recovered" for p in own),
                "hidden": sum(p["status"] == "not identifiable" for p in own),
            }
        )
    return out
