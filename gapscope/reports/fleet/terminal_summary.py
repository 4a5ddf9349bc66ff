"""A fleet on the terminal: what changed, and the worst units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table

from gapscope.arm.display import effect_name, nrmse
from gapscope.diagnosis.document.wording import VERDICTS, capital
from gapscope.reports.fleet.wording import change_line, headline

SHOWN = 10
"""Changes and units that are shown [1]."""


def print_fleet(content: Mapping[str, Any], console: Console) -> None:
    """Print the first lines of ``fleet.json``."""
    lines = [capital(headline(content))]
    lines += [change_line(change) for change in content["changes"][:SHOWN]]
    for line in lines:
        console.print(line, highlight=False, markup=False)
    if content["worst"]:
        console.print(_worst(content))


def _worst(content: Mapping[str, Any]) -> Table:
    table = Table("unit", "last", "verdict", "effects", "gap above floor", box=None)
    for row in content["worst"][:SHOWN]:
        effects = ", ".join(effect_name(effect) for effect in row["effects"])
        verdict = VERDICTS[row["verdict"]]
        table.add_row(row["unit"], row["date"], verdict, effects, nrmse(row["excess"]))
    return table
