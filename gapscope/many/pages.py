"""Pages of many diagnoses: the summary of cases, the table of an archive, the history of a unit, and the fleet."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import date, datetime, timedelta
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pandas as pd
from markupsafe import Markup
from rich.console import Group
from rich.table import Table
from rich.text import Text

from gapscope.arm.display import display_unit, effect_name, nrmse, percent, uncertain
from gapscope.diagnosis.document.numbers import number_rows, place_text
from gapscope.diagnosis.document.wording import VERDICTS, Document, capital
from gapscope.envs.effect_ranges import Z95
from gapscope.many import units as units_words
from gapscope.many.rows import FAILED, Row
from gapscope.reports.diagnosis import DOCUMENT, REPORT
from gapscope.reports.pages import (
    COLOURS,
    ZERO,
    PageSection,
    figure_html,
    render_html,
    subplots,
    terminal_table,
    write_html,
)

# The summary of several cases: one row each, with a link to its report.


COUNTED = {
    "effects_found": "with effects found",
    "no_gap": "without a gap",
    "unexplained": "with an unexplained gap",
    FAILED: "failed",
}
"""Verdicts after their number."""


def render_summary(
    rows: Sequence[Row], path: Path | str, units: Mapping[str, Any] | None = None
) -> None:
    """Write the summary of several cases, in the order given.

    Args:
        rows: one per case.
        path: file to write.
        units: content of ``units.json``, the comparison of the cases as units of one type of arm.

    Raises:
        GapscopeError: ``path`` cannot be written.
    """
    write_html(
        "diagnosis/summary.html",
        path,
        rows=rows,
        counts=_counts(rows, COUNTED),
        labels={**VERDICTS, FAILED: "Failed"},
        groups=() if units is None else units["groups"],
        words=units_words,
    )


def _counts(rows: Sequence[Row], words: Mapping[str, str]) -> list[tuple[str, int]]:
    """Verdicts in words with their number, those that occur."""
    # in the order of the words, not of the numbers
    kinds = Counter(row.verdict for row in rows)
    return [(text, kinds[kind]) for kind, text in words.items() if kinds[kind]]


# Addresses of the pages and files of an archive, as its server takes them.


FILES, UNITS = "files", "unit"
"""First parts of an address: below them are the files of results, and a page for each unit."""


def file_address(row: Row, name: str) -> str:
    """Address of a file beside a diagnosis."""
    folder = "" if row.folder == "." else f"{_quoted(row.folder, '/')}/"
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


def page_count(rows: Sequence[Row]) -> int:
    """Number of pages that the table takes."""
    # rounded up
    return max(1, -(-len(rows) // ROWS))


def render_table(rows: Sequence[Row], folder: str, number: int = 1) -> str:
    """A page of the table as HTML.

    Args:
        rows: of the archive, in the order of the table.
        folder: name of the archive.
        number: of the page, from 1.
    """
    start = (number - 1) * ROWS
    units = {row.unit for row in rows if row.unit}
    return render_html(
        "archive/table.html",
        folder=folder,
        total=len(rows),
        counts=_counts(rows, {**COUNTED, FAILED: "unreadable"}),
        units=len(units),
        number=number,
        pages=page_count(rows),
        **row_content(rows[start : start + ROWS]),
    )


def row_content(rows: Sequence[Row]) -> Document:
    """What ``archive/rows.html`` shows of some diagnoses."""
    return {
        "rows": rows,
        "labels": {**VERDICTS, FAILED: "Unreadable"},
        "file_address": file_address,
        "unit_address": unit_address,
    }


# The page of a unit: its effects over time, a figure for each effect and place.


PANEL, LEGEND, AXIS = 190, 56, 70
"""Heights of one panel, of the legend above and of the axis below [pixels]."""
EDGE = 0.03
"""Part of the time that is drawn beyond both ends, so that no point is on the frame [1]."""


def render_history(rows: Sequence[Row], unit: str) -> str:
    """The page of a unit as HTML: a section for each effect and place, those found most often first.

    Args:
        rows: the diagnoses of the unit, readable ones alone.
        unit: its name.
    """
    in_time = sorted(rows, key=lambda row: (row.date, row.folder))
    numbers = pd.DataFrame(
        {
            **number,
            "effect": capital(effect_name(number["effect"])),
            "place": place_text(number["joint"], number["link"]),
            "date": row.date,
            "folder": row.folder,
            "case": row.case,
        }
        for row in in_time
        if row.document
        for number in number_rows(row.document)
        if number["named"]
    )
    sections: list[tuple[int, PageSection]] = []
    for (effect, place), own in (
        numbers.groupby(["effect", "place"]) if len(numbers) else ()
    ):
        found = set(own["folder"])
        absent = [row.date for row in in_time if row.folder not in found]
        # an effect without numbers is found, and has no curve
        curves, figure = own[own["parameter"] != ""], None
        if len(curves):
            figure = _drawn(curves, absent, f"effect{len(sections)}")
        note = f"Named in {len(found)} of {len(rows)} diagnoses."
        section = PageSection(f"{effect}, {place}", note=note, figure=figure)
        sections.append((len(found), section))
    dates = [row.date_text for row in in_time]
    span = dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}"
    said = "No effect was named in any of them."
    if sections:
        said = (
            "Bars: 95 % intervals. Dotted: a diagnosis that does not name the effect there, which is not a measurement "
            "of zero. Values are relative to each case's own nominal arm: change it, and they step."
        )
    count = f"{len(rows)} diagnos{'is' if len(rows) == 1 else 'es'}"
    # sorted is stable: of those found as often the names decide
    ordered = sorted(sections, key=lambda section: -section[0])
    return render_html(
        "archive/history.html",
        title=f"{unit}: effects over time",
        facts=f"{count}, {span}. {said}",
        sections=[section for _, section in ordered],
        whole=False,
        **row_content(rows),
    )


def _drawn(numbers: pd.DataFrame, absent: Sequence[datetime], name: str) -> Markup:
    """A panel for each parameter, over one axis of time.

    Args:
        numbers: of an effect on one place, in the order of time, with the date of each.
        absent: dates of the diagnoses that do not name it.
        name: of the figure.
    """
    panels = [own for _, own in numbers.groupby(["parameter", "unit"], sort=False)]
    count, names = len(panels), False
    figure = subplots(count, shared_xaxes=True, vertical_spacing=0.12 / count)
    for row, panel in enumerate(panels, 1):
        parameter, unit = panel.iloc[0][["parameter", "unit"]]
        # one unit for a panel: its values share an axis
        factor, shown_unit = display_unit(unit, panel["value"].abs().max())
        components = panel.groupby("component", sort=False)
        names |= len(components) > 1
        for colour, (component, points) in zip(COLOURS, components, strict=False):
            bars = Z95 * factor * points["std"].astype(float)
            figure.add_scatter(
                x=[date.isoformat() for date in points["date"]],
                y=(factor * points["value"]).tolist(),
                # nothing is drawn of a deviation that is not known
                error_y={"array": [bar if bar > 0 else None for bar in bars]},
                text=points["case"].tolist(),
                hovertemplate="%{text}<br>%{x}<br>%{y:.4g}<extra></extra>",
                mode="markers+lines",
                line={"color": colour, "width": 1, "dash": "dot"},
                marker={"color": colour, "size": 7},
                name=f"{parameter.replace('_', ' ')} {component}".strip(),
                showlegend=bool(component),
                row=row,
                col=1,
            )
        bracket = f" [{shown_unit}]" if shown_unit else ""
        title = f"{parameter.replace('_', ' ')}{bracket}"
        figure.update_yaxes(title_text=title, row=row)
    # first and last moment of the axis: the same for all effects of a unit
    dates = [*numbers["date"], *absent]
    first, last = min(dates), max(dates)
    # a single date would leave the axis without a length
    beyond = max(EDGE * (last - first), timedelta(days=1))
    span = [(first - beyond).isoformat(), (last + beyond).isoformat()]
    figure.update_xaxes(type="date", range=span)
    figure.update_xaxes(title_text="date", row=count)
    if absent:
        # one path, since there may be thousands; a blank would part the date in two numbers of it
        path = " ".join(f"M {date:%Y-%m-%d_%H:%M:%S},0 V 1" for date in absent)
        line = {"color": ZERO, "width": 1, "dash": "dot"}
        place = {"xref": "x", "yref": "paper", "layer": "below"}
        figure.add_shape(type="path", path=path, line=line, **place)
    top = LEGEND if names else 12
    margin = {"l": 62, "r": 14, "t": top, "b": 46}
    return figure_html(figure, name, PANEL * count + top + AXIS, margin=margin)


# A fleet in words: its headline, places of effects, values and changes.


def headline(content: Document) -> str:
    """What a fleet's document says, in one sentence."""
    units = _count(content["units"], "unit")
    cases = _count(content["cases"], "case")
    changed = content["units_changed"]
    what = f"{_count(changed, 'unit')} changed" if changed else "no unit changed"
    failed = (
        f"; {_count(content['failed'], 'case')} failed" if content["failed"] else ""
    )
    return f"{units} in {cases}: {what}{failed}"


def value_words(value: float, std: float | None, unit: str) -> str:
    """A value with its deviation in a readable unit."""
    factor, shown = display_unit(unit, abs(value))
    text = uncertain(factor * value, None if std is None else factor * std)
    return f"{text} {shown}".strip()


def change_words(change: Document) -> str:
    """What changed, from what to what."""
    before, after = change["before"], change["after"]
    # found more or less often: no value to give
    if change["kind"] != "value":
        shares = f"{percent(before['value'])} to {percent(after['value'])}"
        return f"{change['kind']}: named in {shares} of the diagnoses"
    name = f"{change['parameter'].replace('_', ' ')} {change['component']}".strip()
    values = [
        value_words(v["value"], v["std"], change["si_unit"]) for v in (before, after)
    ]
    return f"{name} from {values[0]} to {values[1]}"


def change_line(change: Document) -> str:
    """A change as a line of the terminal."""
    effect = capital(effect_name(change["effect"]))
    dates = f"between {change['last_before']} and {change['first_after']}"
    where = place_text(change["joint"], change["link"])
    return f"{change['unit']}: {effect}, {where}, {change_words(change)}, {dates}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


# A history as a small drawing: points with intervals, and the means before and after its change.


WIDTH, HEIGHT, MARGIN = 220, 46, 4
"""Size of the drawing and its margin [pixels]."""


def sparkline(change: Document) -> dict[str, Any]:
    """The history of a change in pixels: ``points`` (x, y, and the ends of the bar), and ``levels`` (from, y, to)."""
    points = change["history"]
    days = [date.fromisoformat(point["date"]).toordinal() for point in points]
    # found and not found have no deviation
    value, std = (
        np.array([point[key] or 0.0 for point in points]) for key in ("value", "std")
    )
    means = np.array([change[key]["value"] for key in ("before", "after")])
    x = _scaled(np.array(days, float), WIDTH)
    # upwards on the screen is downwards in its coordinates
    drawn = np.concatenate([value, value - Z95 * std, value + Z95 * std, means])
    y = HEIGHT - _scaled(drawn, HEIGHT)
    # a change may lie before the points that are kept
    split = sum(point["date"] <= change["last_before"] for point in points)
    spans = (x[: max(split, 1)], x[min(split, len(x) - 1) :])
    return {
        "width": WIDTH,
        "height": HEIGHT,
        # the first three are the points and their ends, the last two the means
        "points": [*zip(x, *y[:-2].reshape(3, -1), strict=True)],
        "levels": [
            (own[0] - 2, level, own[-1] + 2)
            for level, own in zip(y[-2:], spans, strict=True)
        ],
    }


def _scaled(numbers: np.ndarray, size: int) -> np.ndarray:
    """Numbers as pixels from one margin to the other; in the middle if all are the same."""
    least, most = numbers.min(), numbers.max()
    if most == least:
        return np.full(len(numbers), size / 2)
    return np.interp(numbers, (least, most), (MARGIN, size - MARGIN))


# The page of a fleet: ``fleet.html``.


KINDS = {
    "shared": "on all units, alike",
    "shared_differing_size": "on all units, of different size",
    "some_units": "on some units",
    "one_unit": "on one unit",
}


def render_fleet(content: Document, path: Path) -> None:
    """Write the page, in the folder of the results; raises ``GapscopeError`` if it cannot be written."""

    def linked(kept: str) -> str:
        """What is opened of a diagnosis; each run says which of its files are kept."""
        return REPORT if (path.parent / kept / REPORT).is_file() else DOCUMENT

    write_html(
        "fleet/fleet.html",
        path,
        fleet=content,
        headline=headline(content),
        kinds=KINDS,
        verdicts=VERDICTS,
        place=place_text,
        change_words=change_words,
        value_words=value_words,
        sparkline=sparkline,
        false_share=percent(content["false_share"]),
        linked=linked,
    )


# A fleet on the terminal: what changed, and the worst units.


SHOWN = 10
"""Changes and units that are shown [1]."""


def summary(content: Document) -> Group:
    """The first lines of ``fleet.json``."""
    lines = [capital(headline(content))]
    lines += [change_line(change) for change in content["changes"][:SHOWN]]
    shown: list[Text | Table] = [*map(Text, lines)]
    rows = [
        (
            row["unit"],
            row["date"],
            VERDICTS[row["verdict"]],
            ", ".join(effect_name(effect) for effect in row["effects"]),
            nrmse(row["excess"]),
        )
        for row in content["worst"][:SHOWN]
    ]
    if rows:
        heads = ("unit", "last", "verdict", "effects", "gap above floor")
        shown.append(terminal_table(heads, rows, len(heads), box=None))
    return Group(*shown)
