"""How large effects would have to be to be named, as a table."""

from __future__ import annotations

from collections.abc import Iterable
from textwrap import wrap

from rich.console import Group
from rich.text import Text

from gapscope.arm.display import MISSING, display_unit, effect_name, significant
from gapscope.diagnosis.document.wording import Document
from gapscope.reports.pages import PLAIN, terminal_table


def expected_rows(
    entries: Iterable[Document], n_joints: int
) -> list[tuple[str, list[str]]]:
    """Name and unit of each effect, then a text per joint: the size named in nine cases of ten, of one half after it.

    What acts on the whole arm stands under the first joint.
    """
    rows: dict[str, list[str]] = {}
    for entry in entries:
        # one unit for all joints of a row, whatever their sizes
        factor, unit = display_unit(entry["unit"], 1.0)
        unit = f" [{unit}]" if unit else ""
        name = f"{effect_name(entry['effect'])}, {entry['parameter'].replace('_', ' ')}{unit}"
        # joints without an entry stay blank: nothing was asked of them
        texts = rows.setdefault(name, [""] * n_joints)
        most, half = (
            MISSING if entry[key] is None else significant(factor * entry[key], 2)
            for key in ("nine_of_ten", "half")
        )
        # one text if both read the same, as two dashes do
        text = most if half == most else f"{most} ({half})"
        for joint in entry["joints"] or [1]:
            texts[joint - 1] = text
    return list(rows.items())


TITLE = "named in nine cases of ten from this size on (in half of them)"


JOINTS = 7
"""Of one table at most: more than a terminal is wide."""


def expected_table(entries: Iterable[Document], n_joints: int) -> Group:
    """The same on the terminal; arms of many joints have several tables."""
    rows = expected_rows(entries, n_joints)
    tables = []
    for start in range(0, n_joints, JOINTS):
        some = slice(start, start + JOINTS)
        here = [(name, texts[some]) for name, texts in rows if any(texts[some])]
        # words of names are not cut, however many joints there are
        width = max((len(word) for name, _ in here for word in name.split()), default=1)
        cells: list[list[str | Text]] = [
            [Text("\n".join(wrap(name, width))), *texts] for name, texts in here
        ]
        heads = ["effect", *(str(j + 1) for j in range(n_joints)[some])]
        table = terminal_table(heads, cells, whole=slice(1), title=TITLE, **PLAIN)
        tables.append(table)
    return Group(*tables)
