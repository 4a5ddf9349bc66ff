"""What the report says of identifiability, segments and torque intervals, made of the document alone."""

from __future__ import annotations

from typing import Any

from gapscope.arm.joint_units import common_unit
from gapscope.reports.identification.sections import joint_slides


def identifiability(document: dict[str, Any]) -> dict[str, Any]:
    """Sentences, and the parameters by their standing."""
    shown, base = document["identifiability"], document["base"]
    standing: dict[str, list[str]] = {
        "recovered": [],
        "only in combination": [],
        "not identifiable": [],
    }
    for parameter in document["parameters"]:
        standing[parameter["status"]].append(parameter["name"])
    high = base["condition"] > shown["condition_limit"]
    return {
        "standing": [
            {"status": key, "names": names} for key, names in standing.items()
        ],
        "high": high,
        "limit": shown["condition_limit"],
        "rank": (
            f"The arm has {shown['structural']} base parameters; the fitted samples determine {shown['rank']} of them."
        ),
        "essential": _essential(document),
        "groups": _groups(document),
    }


def _essential(document: dict[str, Any]) -> str:
    found, count = document["essential"], document["base"]["count"]
    if found is None:
        return "Essential parameters could not be told: the samples do not suffice."
    if not found["dropped"]:
        return f"All {count} are essential: each is known well enough, or the torque needs it."
    return (
        f"{len(found['names'])} of {count} are essential; without the other {len(found['dropped'])} the residual grows "
        f"by {100 * found['residual_growth']:.1f} %."
    )


def _groups(document: dict[str, Any]) -> str:
    found = document["repeated_groups"]
    if found is None:
        return "Segments could not be compared: one of them does not determine the parameters by itself."
    return (
        f"Identified from each of {found['count']} segments by itself: variance between them over the variance that "
        f"they state is {found['ratio']:.2g}; {found['meaning']}."
    )


def intervals(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of the table of torque intervals: a label and a number per joint; empty if there are none."""
    found = document["torque_interval"]
    if found is None:
        return []
    unit = common_unit("N m", joint_slides(document))
    return [
        {
            "label": "half width, the arm's torque",
            "unit": unit,
            "values": found["half_width"],
        },
        {
            "label": "half width, torque as recorded",
            "unit": unit,
            "values": found["half_width_recorded"],
        },
        {
            "label": "model error, standard deviation",
            "unit": unit,
            "values": found["model_error"],
        },
        {"label": "noise, standard deviation", "unit": unit, "values": found["noise"]},
    ]
