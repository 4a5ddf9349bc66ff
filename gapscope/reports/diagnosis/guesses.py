"""What the report says of the part of a gap that no effect explains and a flexible model still predicts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gapscope.arm.display import percent
from gapscope.diagnosis.result import Diagnosis
from gapscope.reports.diagnosis.encoding import encode

WHITE = 1e-3
"""With a larger p-value the residual may be noise."""
NAMES = {
    "position": "its position",
    "speed": "its speed",
    "velocity": "its velocity",
    "direction": "the direction in which it moves",
    "acceleration": "its acceleration",
    "load": "the torque that it carries",
    "time": "the time since the recording began",
    "frequency": "an oscillation that follows no motion",
}


@dataclass(frozen=True)
class Guess:
    """One picture: its place among the curves, and what it shows, in words."""

    index: int
    title: str
    words: str


def guesses(diagnosis: Diagnosis) -> list[Guess]:
    """One picture for each joint left above the floor, in the order of ``curves``."""
    return [
        Guess(i, f"J{e['joint']}: {_title(e)}", _words(e))
        for i, e in enumerate(_entries(diagnosis))
    ]


def curves(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """The curves as JSON-ready values."""
    return [
        {
            "joint": entry["joint"] - 1,
            "axis": f"{entry['curve']['variable']} [{entry['curve']['unit']}]",
            "amplitude": entry["curve"]["variable"] == "frequency",
            "x": encode(entry["curve"]["x"]),
            "y": encode(entry["curve"]["y"]),
        }
        for entry in _entries(diagnosis)
    ]


def _entries(diagnosis: Diagnosis) -> list[Mapping[str, Any]]:
    return list(diagnosis.document["unexplained"].get("predictable", []))


def _title(entry: Mapping[str, Any]) -> str:
    return f"{percent(entry['share'])} of what is left can be predicted"


def _words(entry: Mapping[str, Any]) -> str:
    """How much of it which variable predicts, and whether the residual may be noise."""
    name = entry["curve"]["variable"]
    noise = "may be noise" if entry["whiteness_p"] > WHITE else "is no noise"
    if entry["share"] == 0.0:
        return f"What is left {noise}, but nothing known of the motion predicts it on unseen data."
    alone = (
        f"{NAMES[name].capitalize()} alone predicts {percent(entry['by'][name])} of it."
    )
    shown = (
        "how strong the gap is at each frequency"
        if name == "frequency"
        else "the gap along it"
    )
    return f"{alone} The curve is {shown}. What is left {noise}."
