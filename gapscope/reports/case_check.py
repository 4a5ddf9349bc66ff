"""The check of a case on the terminal: one line per remark, then the motion of each joint."""

from __future__ import annotations

from typing import Any

from rich.console import Group
from rich.text import Text

from gapscope.diagnosis.document.wording import Document
from gapscope.reports.expected import expected_table
from gapscope.reports.pages import PLAIN, terminal_table

STYLES = {"ok": "green", "warn": "yellow", "error": "bold red"}
"""Style of a level."""


def summary(content: Document) -> Group:
    """All remarks, errors first, and how the joints move."""
    remarks = sorted(
        content["remarks"], key=lambda one: ("error", "warn", "ok").index(one["level"])
    )
    rows = []
    for one in remarks:
        said = f"{one['place']}: {one['said']}" if one["place"] else one["said"]
        text = Text(said, overflow="fold")
        if one["remedy"]:
            text.append(f"\n→ {one['remedy']}", "dim")
        rows.append((Text(one["level"], STYLES[one["level"]]), one["topic"], text))
    named = ("", "topic", "found, and what to do")
    parts: list[Any] = [terminal_table(named, rows, 3, slice(2), **PLAIN)]
    # known only if motion and torque could be looked at
    if content["excited"] is not None:
        keys = ("range", "slow", "fast", "reversals", "gravity", "possible_gravity")
        heads = ("joint", *keys[:4], "gravity", "possible")
        moving = [
            [f"{k} {joint['name']}", *(_text(joint[key]) for key in keys)]
            for k, joint in enumerate(content["joints"], 1)
        ]
        units = "\nhow the joints move (rad, s and N m; m, s and N if they slide)"
        parts += [Text(units, "italic"), terminal_table(heads, moving, **PLAIN)]
    if content["expected"]:
        parts += [Text(""), expected_table(content["expected"], len(content["joints"]))]
    name = content["case"] or "the case"
    word = "can be diagnosed" if content["can_be_diagnosed"] else "cannot be diagnosed"
    if any(one["level"] == "warn" and one["topic"] == "torque" for one in remarks):
        word += "; first see to what is said of its torque"
    return Group(*parts, Text(f"\n{name} {word}", "bold"))


def _text(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.3g}"
