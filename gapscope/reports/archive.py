"""The archive as pages: the table of all diagnoses and the history of one unit."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from datetime import timedelta
from typing import Any
from urllib.parse import quote

from markupsafe import Markup

from gapscope.archive import UNREADABLE, EffectHistory, Entry, Point, histories
from gapscope.arm.display import display_unit
from gapscope.diagnosis.document.wording import VERDICTS, capital
from gapscope.reports.pages import (
    COLOURS,
    ZERO,
    PageSection,
    figure_html,
    render_html,
    subplots,
)

# Addresses of the pages and files of an archive, as its server takes them.


FILES, UNITS = "files", "unit"
"""First parts of an address: below them are the files of results, and a page for each unit."""


def file_address(entry: Entry, name: str) -> str:
    """Address of a file beside a diagnosis."""
    folder = "" if entry.folder == "." else f"{_quoted(entry.folder, '/')}/"
    return f"/{FILES}/{folder}{name}"


def unit_address(unit: str) -> str:
    """Address of the page of a unit."""
    return f"/{UNITS}/{_quoted(unit)}"


def _quoted(name: str, safe: str = "") -> str:
    # as bytes: a name on disk need not be valid text
    return quote(os.fsencode(name), safe=safe)


# The page of all diagnoses of an archive: a row each, the latest first.


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


# The page of a unit: its effects over time, a figure for each effect and place.


INTERVAL = 1.96
"""Standard deviations to each side of an interval of 95 %, for normal errors [1]."""
PANEL, LEGEND, AXIS = 190, 56, 70
"""Heights of one panel, of the legend above and of the axis below [pixels]."""
EDGE = 0.03
"""Part of the time that is drawn beyond both ends, so that no point is on the frame [1]."""


def render_history(entries: Sequence[Entry], unit: str) -> str:
    """The page of a unit as HTML.

    Args:
        entries: the diagnoses of the unit, readable ones alone.
        unit: its name.
    """
    effects = histories(entries, unit)
    figures = (_section(effect, n) for n, effect in enumerate(effects))
    return render_html(
        "archive/history.html",
        title=f"{unit}: effects over time",
        facts=_facts(entries, effects),
        sections=list(figures),
        whole=False,
        **row_content(entries),
    )


def _facts(entries: Sequence[Entry], effects: Sequence[EffectHistory]) -> str:
    dates = sorted(entry.date_text for entry in entries)
    count = f"{len(entries)} diagnos{'is' if len(entries) == 1 else 'es'}"
    span = dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}"
    if not effects:
        return f"{count}, {span}. No effect was named in any of them."
    return (
        f"{count}, {span}. Bars: 95 % intervals. Dotted: a diagnosis that does not name the effect there, which is not "
        "a measurement of zero. Values are relative to each case's own nominal arm: change it, and they step."
    )


def _section(history: EffectHistory, number: int) -> PageSection:
    found, absent = len(history.found), len(history.absent)
    note = f"Named in {found} of {found + absent} diagnoses."
    return PageSection(
        f"{capital(history.effect)}, {history.place}",
        note=note,
        figure=_drawn(history, f"effect{number}") if history.parameters else None,
    )


def _drawn(history: EffectHistory, name: str) -> Markup:
    """A panel for each parameter, over one axis of time."""
    count = len(history.parameters)
    figure = subplots(count, shared_xaxes=True, vertical_spacing=0.12 / count)
    for row, ((parameter, unit), components) in enumerate(
        history.parameters.items(), 1
    ):
        factor, shown_unit = _shown_unit(unit, components)
        for colour, (component, points) in zip(
            COLOURS, components.items(), strict=False
        ):
            stds = [number.std for _, number in points]
            figure.add_scatter(
                x=[entry.date.isoformat() for entry, _ in points],
                y=[factor * float(number.value or 0.0) for _, number in points],
                error_y={
                    "array": [INTERVAL * factor * std if std else None for std in stds]
                },
                text=[entry.case for entry, _ in points],
                hovertemplate="%{text}<br>%{x}<br>%{y:.4g}<extra></extra>",
                mode="markers+lines",
                line={"color": colour, "width": 1, "dash": "dot"},
                marker={"color": colour, "size": 7},
                name=f"{parameter} {component}".strip(),
                showlegend=bool(component),
                row=row,
                col=1,
            )
        bracket = f" [{shown_unit}]" if shown_unit else ""
        figure.update_yaxes(title_text=f"{parameter}{bracket}", row=row)
    # first and last moment of the axis: the same for all effects of a unit
    first, last = history.span
    beyond = max(EDGE * (last - first), timedelta(days=1))
    drawn_span = [(first - beyond).isoformat(), (last + beyond).isoformat()]
    figure.update_xaxes(type="date", range=drawn_span)
    figure.update_xaxes(title_text="date", row=count)
    figure.update_layout(shapes=_absent_lines(history))
    named = any(len(components) > 1 for components in history.parameters.values())
    top = LEGEND if named else 12
    margin = {"l": 62, "r": 14, "t": top, "b": 46}
    return figure_html(figure, name, PANEL * count + top + AXIS, margin=margin)


def _shown_unit(unit: str, components: dict[str, list[Point]]) -> tuple[float, str]:
    """One readable unit for all values of a panel, and the factor to it."""
    points = (point for of_one in components.values() for point in of_one)
    return display_unit(unit, max(abs(number.value or 0.0) for _, number in points))


def _absent_lines(history: EffectHistory) -> list[dict[str, object]]:
    """Dotted lines at the diagnoses without the effect: one path, since there may be thousands."""
    dates = [f"{date:%Y-%m-%d_%H:%M:%S}" for date in history.absent]
    if not dates:
        return []
    path = " ".join(f"M {date},0 V 1" for date in dates)
    line = {"color": ZERO, "width": 1, "dash": "dot"}
    place = {"xref": "x", "yref": "paper", "layer": "below"}
    return [{"type": "path", "path": path, "line": line, **place}]
