"""Pages of many diagnoses: the summary of cases, the table of an archive, the history of a unit, and the fleet."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date, datetime, timedelta
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from markupsafe import Markup
from rich.console import Group
from rich.table import Table
from rich.text import Text

from gapscope.arm.display import display_unit, effect_name, nrmse, percent, uncertain
from gapscope.diagnosis.document.numbers import Number, place_text
from gapscope.diagnosis.document.wording import VERDICTS, capital
from gapscope.envs.effect_ranges import Z95
from gapscope.many import units as units_words
from gapscope.many.rows import FAILED, Row
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


def row_content(rows: Sequence[Row]) -> dict[str, Any]:
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


@dataclass
class EffectHistory:
    """An effect on one place over time.

    Attributes:
        effect: its readable name.
        place: ``joint 4``, ``link 3`` or ``the whole arm``.
        found: diagnoses that name the effect there.
        absent: dates of the other diagnoses of the unit.
        parameters: by parameter and its unit, then by component, all points in order of time: diagnosis and number.
    """

    effect: str
    place: str
    found: list[Row] = field(default_factory=list)
    absent: list[datetime] = field(default_factory=list)
    parameters: dict[tuple[str, str], dict[str, list[Point]]] = field(
        default_factory=dict
    )


Point = tuple[Row, Number]


def histories(rows: Iterable[Row], unit: str) -> list[EffectHistory]:
    """Effects of a unit, those found most often first.

    Args:
        rows: of an archive.
        unit: its name; diagnoses of other units and unreadable ones are left out.
    """
    # values of other arms and unreadable files say nothing of this one
    of_unit = [row for row in rows if row.unit == unit and row.document is not None]
    in_time = sorted(of_unit, key=lambda row: (row.date, row.folder))
    made: dict[tuple[str, str], EffectHistory] = {}
    for row in in_time:
        for number in (number for effect in row.effects for number in effect.numbers):
            key = effect_name(number.effect), number.place
            history = made.setdefault(key, EffectHistory(*key))
            # diagnoses come in order: only the last one can be the same
            if row not in history.found[-1:]:
                history.found.append(row)
            # an effect without numbers is found, and has no curve
            if number.parameter:
                name = number.parameter.replace("_", " "), number.unit
                points = history.parameters.setdefault(name, {})
                points.setdefault(number.component, []).append((row, number))
    for history in made.values():
        folders = {row.folder for row in history.found}
        history.absent = [row.date for row in in_time if row.folder not in folders]
    return sorted(made.values(), key=lambda h: (-len(h.found), h.effect, h.place))


def render_history(rows: Sequence[Row], unit: str) -> str:
    """The page of a unit as HTML.

    Args:
        rows: the diagnoses of the unit, readable ones alone.
        unit: its name.
    """
    effects = histories(rows, unit)
    figures = (_section(effect, n) for n, effect in enumerate(effects))
    return render_html(
        "archive/history.html",
        title=f"{unit}: effects over time",
        facts=_facts(rows, effects),
        sections=list(figures),
        whole=False,
        **row_content(rows),
    )


def _facts(rows: Sequence[Row], effects: Sequence[EffectHistory]) -> str:
    dates = sorted(row.date_text for row in rows)
    count = f"{len(rows)} diagnos{'is' if len(rows) == 1 else 'es'}"
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
        # one unit for a panel: its values share an axis
        factor, shown_unit = _shown_unit(unit, components)
        for colour, (component, points) in zip(
            COLOURS, components.items(), strict=False
        ):
            stds = [number.std for _, number in points]
            figure.add_scatter(
                x=[row.date.isoformat() for row, _ in points],
                y=[factor * float(number.value or 0.0) for _, number in points],
                error_y={
                    "array": [Z95 * factor * std if std else None for std in stds]
                },
                text=[row.case for row, _ in points],
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
    dates = [*(row.date for row in history.found), *history.absent]
    first, last = min(dates), max(dates)
    # a single date would leave the axis without a length
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
    # a blank would part the date in two numbers of the path
    dates = [f"{date:%Y-%m-%d_%H:%M:%S}" for date in history.absent]
    if not dates:
        return []
    path = " ".join(f"M {date},0 V 1" for date in dates)
    line = {"color": ZERO, "width": 1, "dash": "dot"}
    place = {"xref": "x", "yref": "paper", "layer": "below"}
    return [{"type": "path", "path": path, "line": line, **place}]


# A fleet in words: its headline, places of effects, values and changes.


def headline(content: Mapping[str, Any]) -> str:
    """What a fleet's document says, in one sentence."""
    units = _count(content["units"], "unit")
    cases = _count(content["cases"], "case")
    # a unit may change in several effects, and counts once
    changed = len({change["unit"] for change in content["changes"]})
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


def change_words(change: Mapping[str, Any]) -> str:
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


def change_line(change: Mapping[str, Any]) -> str:
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


def sparkline(change: Mapping[str, Any]) -> Markup:
    """The history of a change as SVG, in colours of the page."""
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
    # the first three are the points and their ends, the last two the means
    middle, low, high = y[: 3 * len(x)].reshape(3, -1)
    bars = [f"M{a:.1f} {b:.1f}V{c:.1f}" for a, b, c in zip(x, low, high, strict=True)]
    parts = [f'<path class="bars" d="{" ".join(bars)}"/>']
    for a, b in zip(x, middle, strict=True):
        parts.append(f'<circle cx="{a:.1f}" cy="{b:.1f}" r="2"/>')
    # a change may lie before the points that are kept
    split = sum(point["date"] <= change["last_before"] for point in points)
    spans = (x[: max(split, 1)], x[min(split, len(x) - 1) :])
    for level, own in zip(y[-2:], spans, strict=True):
        line = f"M{own[0] - 2:.1f} {level:.1f}H{own[-1] + 2:.1f}"
        parts.append(f'<path class="mean" d="{line}"/>')
    label = f"{len(points)} diagnoses, {points[0]['date']} to {points[-1]['date']}"
    # all parts are numbers and dates
    return Markup(
        f'<svg class="sparkline" role="img" aria-label="{label}" width="{WIDTH}" height="{HEIGHT}">'
        f"<title>{label}</title>{''.join(parts)}</svg>"
    )


def _scaled(numbers: np.ndarray, size: int) -> np.ndarray:
    """Numbers as pixels from one margin to the other; in the middle if all are the same."""
    least, most = numbers.min(), numbers.max()
    if most == least:
        return np.full(len(numbers), size / 2)
    return MARGIN + (size - 2 * MARGIN) / (most - least) * (numbers - least)


# The page of a fleet: ``fleet.html``.


REPORT, DOCUMENT = "report.html", "diagnosis.json"
KINDS = {
    "shared": "on all units, alike",
    "shared_differing_size": "on all units, of different size",
    "some_units": "on some units",
    "one_unit": "on one unit",
}


def render_fleet(content: Mapping[str, Any], path: Path, *, reports: bool) -> None:
    """Write the page.

    Args:
        content: of ``fleet.json``.
        path: the page, in the folder of the results.
        reports: whether diagnoses were kept with their reports, which are linked then.

    Raises:
        GapscopeError: ``path`` cannot be written.
    """
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
        linked=REPORT if reports else DOCUMENT,
    )


# A fleet on the terminal: what changed, and the worst units.


SHOWN = 10
"""Changes and units that are shown [1]."""


def summary(content: Mapping[str, Any]) -> Group:
    """The first lines of ``fleet.json``."""
    lines = [capital(headline(content))]
    lines += [change_line(change) for change in content["changes"][:SHOWN]]
    worst = [_worst(content)] if content["worst"] else []
    return Group(*map(Text, lines), *worst)


def _worst(content: Mapping[str, Any]) -> Table:
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
    heads = ("unit", "last", "verdict", "effects", "gap above floor")
    return terminal_table(heads, rows, len(heads), box=None)
