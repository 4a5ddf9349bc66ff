"""The check of a case on the terminal: one line per remark, then the motion of each joint."""

from __future__ import annotations

from typing import Any

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

STYLES = {"ok": "green", "warn": "yellow", "error": "bold red"}
"""Style of a level."""


def summary(content: dict[str, Any]) -> Group:
    """All remarks, errors first, and how the joints move."""
    remarks = sorted(
        content["remarks"], key=lambda one: ("error", "warn", "ok").index(one["level"])
    )
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0))
    table.add_column("", no_wrap=True)
    table.add_column("topic", no_wrap=True)
    table.add_column("found, and what to do", overflow="fold")
    for one in remarks:
        said = f"{one['place']}: {one['said']}" if one["place"] else one["said"]
        text = Text(said)
        if one["remedy"]:
            text.append(f"\n→ {one['remedy']}", "dim")
        level = Text(one["level"], STYLES[one["level"]])
        table.add_row(level, one["topic"], text)
    parts: list[Any] = [table]
    if content["excited"] is not None:
        parts += [Text(""), _joints(content)]
    name = content["case"] or "the case"
    word = "can be diagnosed" if content["can_be_diagnosed"] else "cannot be diagnosed"
    if any(one["level"] == "warn" and one["topic"] == "torque" for one in remarks):
        word += "; first see to what is said of its torque"
    return Group(*parts, Text(f"\n{name} {word}", "bold"))


def _joints(content: dict[str, Any]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0))
    heads = ("joint", "range", "slow", "fast", "reversals", "gravity [N m]", "possible")
    for head in heads:
        table.add_column(head, justify="left" if head == "joint" else "right")
    for number, joint in enumerate(content["joints"], 1):
        values = [joint[key] for key in ("range", "slow", "fast")]
        gravity = [joint[key] for key in ("gravity", "possible_gravity")]
        table.add_row(
            f"{number} {joint['name']}",
            *(f"{value:.3g}" for value in values),
            str(joint["reversals"]),
            *(f"{value:.3g}" for value in gravity),
        )
    return table
