"""The page of all diagnoses of an archive: a row each, the latest first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from gapscope.archive.entry import UNREADABLE, Entry
from gapscope.diagnosis.document.wording import VERDICTS
from gapscope.reports.archive.addresses import file_address, unit_address
from gapscope.reports.pages import render_html

ROWS = 1000
"""Most rows of a page."""
LABELS = {**VERDICTS, UNREADABLE: "Unreadable"}
COUNTED = {
    "effects_found": "with effects found",
    "no_gap": "without a gap",
    "unexplained": "with an unexplained gap",
    UNREADABLE: "unreadable",
}
"""Verdicts after their number."""


def page_count(entries: Sequence[Entry]) -> int:
    """Number of pages that the table takes."""
    return max(1, -(-len(entries) // ROWS))


def render_table(entries: Sequence[Entry], folder: str, number: int = 1) -> str:
    """A page of the table as HTML.

    Args:
        entries: of the archive, in the order of the table.
        folder: name of the archive.
        number: of the page, from 1.
    """
    start = (number - 1) * ROWS
    kinds = Counter(entry.verdict for entry in entries)
    units = {entry.unit for entry in entries if entry.unit}
    return render_html(
        "archive/table.html",
        folder=folder,
        total=len(entries),
        counts=[(words, kinds[kind]) for kind, words in COUNTED.items() if kinds[kind]],
        units=len(units),
        number=number,
        pages=page_count(entries),
        **row_content(entries[start : start + ROWS]),
    )


def row_content(rows: Sequence[Entry]) -> dict[str, Any]:
    """What ``archive/rows.html`` shows of some diagnoses."""
    return {
        "rows": rows,
        "labels": LABELS,
        "file_address": file_address,
        "unit_address": unit_address,
    }
