"""The comparison of units as tables on the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gapscope.arm.display import nrmse
from gapscope.reports.diagnosis.fleet_section import (
    cells,
    findings,
    heading,
    nominal_note,
    row_label,
    told_apart,
)


def fleet_tables(content: Mapping[str, Any]) -> Group:
    """The content of ``units.json``: per type of arm the effects with the units that have them, and the confusion."""
    parts: list[RenderableType] = []
    for group in content["groups"]:
        confusion = group["confusion"]
        parts.append(_effects(group))
        if confusion["columns"]:
            parts.append(_confusion(confusion))
        notes = (*told_apart(confusion), nominal_note(group))
        parts += [Text(note) for note in notes if note]
    return Group(*parts)


def _effects(group: Mapping[str, Any]) -> Table:
    """Effects of a group and the units that have them."""
    table = Table(
        title=f"{group['robot']}, {len(group['units'])} units",
        title_justify="left",
        caption=heading(group),
        caption_justify="left",
    )
    for name in ("effect", "on", "found"):
        table.add_column(name, overflow="fold")
    for found in findings(group):
        meaning = Text(f"{found.label}: {found.meaning}")
        table.add_row(Text(found.name), found.place, meaning)
    return table


def _confusion(confusion: Mapping[str, Any]) -> Table:
    """Mean torque NRMSE of each arm on the recordings of each unit; the least of each column in bold."""
    table = Table(
        title="torque NRMSE of an arm (row) on the recordings of a unit (column)",
        title_justify="left",
    )
    table.add_column("")
    for unit in confusion["columns"]:
        table.add_column(Text(unit), justify="right")
    for row, line in cells(confusion):
        values = (Text(nrmse(c.value), "bold" if c.best else "") for c in line)
        table.add_row(Text(row_label(row)), *values)
    return table
