"""What is in a log on the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Group
from rich.table import Table
from rich.text import Text

from gapscope.inspection.draft_check import DraftCheck
from gapscope.inspection.inspection import Inspection
from gapscope.reports.inspection.page import (
    channel_rows,
    facts_of,
    joint_rows,
    torque_rows,
    wrong_rows,
)


def summary(found: Inspection, checked: DraftCheck) -> Group:
    """Tables of columns, torques, joints and of what looks wrong."""
    parts: list[Text | Table] = [Text(facts_of(found))]
    parts += [
        _table(
            "columns",
            ("channel", "columns", "unit", "because"),
            list(channel_rows(found)),
        ),
        _table("torque", ("columns", "seen"), list(torque_rows(found))),
        _table("joints", ("joint", "from", "to", "fastest"), list(joint_rows(found))),
    ]
    wrong = wrong_rows(found, checked)
    if wrong:
        parts.append(_table("what looks wrong", ("where", "what", "what to do"), wrong))
    else:
        parts.append(Text("Nothing looks wrong."))
    return Group(*parts)


def _table(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold")
    for head in heads:
        table.add_column(head, overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    return table
