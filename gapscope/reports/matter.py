"""What matters for a task, on the terminal and as a page."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from rich.console import Group

from gapscope.arm.display import MISSING, display_unit, effect_name, percent
from gapscope.diagnosis.document.wording import Document, acts_on
from gapscope.reports.pages import (
    PLAIN,
    PageSection,
    drawn,
    figure_html,
    with_bars,
    write_plot_page,
)

HEADS = ("effect", "acts on", "matters", "alone", "all but it", "success", "values")
TO_MRAD = 1e3
"""Errors are shown in mrad."""


def error_text(interval: Mapping[str, float | None]) -> str:
    """``3.2 mrad (3.0..3.4)``; of a slide a radian stands for a metre."""
    # an infinite error is null in a document
    if interval["value"] is None or not np.isfinite(interval["value"]):
        return "diverged"
    low, value, high = (
        MISSING if x is None else f"{TO_MRAD * x:.3g}"
        for x in (interval["low"], interval["value"], interval["high"])
    )
    return f"{value} mrad" if low == high else f"{value} mrad ({low}..{high})"


def sentence(content: Document) -> str:
    """What matters most and least, beside the errors without and with all effects."""
    # rows come with what matters most first
    first, last = content["rows"][0], content["rows"][-1]
    text = (
        f"Tracking error of {error_text(content['nominal']['error'])} without effects and "
        f"{error_text(content['all']['error'])} with all; {_name(first)} matters most: {error_text(first['matters'])}"
    )
    if last is not first:
        text += f", {_name(last)} least: {error_text(last['matters'])}"
    return f"{text}."


def _name(row: Document) -> str:
    """``coulomb friction (joint 2)``."""
    return f"{effect_name(row['effect'])} ({acts_on(row)})"


def table(content: Document) -> PageSection:
    """A row for each effect, what matters most first."""
    rows = []
    for row in content["rows"]:
        values = []
        for name, known in row["range"].items():
            low, high = np.min(known["low"]), np.max(known["high"])
            factor, unit = display_unit(known["unit"], float(np.abs(high)))
            # one number if both ends are the same
            ends = dict.fromkeys((f"{factor * low:.3g}", f"{factor * high:.3g}"))
            values.append(f"{name} {' to '.join(ends)} {unit}".strip())
        success = (row[key]["success"]["value"] for key in ("alone", "without"))
        rows.append(
            (
                effect_name(row["effect"]),
                acts_on(row),
                error_text(row["matters"]),
                error_text(row["alone"]["error"]),
                error_text(row["without"]["error"]),
                ", ".join(percent(x) for x in success),
                "; ".join(values),
            )
        )
    return PageSection("What each effect does to the task", HEADS, rows)


def summary(content: Document) -> Group:
    """The table and its sentence on a terminal."""
    return Group(table(content).on_terminal(**PLAIN), "", content["summary"])


def write_page(content: Document, path: Path) -> None:
    """Write the page: a bar for each effect, and the table.

    Raises:
        GapscopeError: the file cannot be written.
    """
    bars = [{"row": _name(row), **row["matters"]} for row in content["rows"]]
    figure = drawn(
        "bar",
        with_bars(bars, TO_MRAD),
        {"value": "change of the tracking error [mrad]", "row": ""},
        error_x="above",
        error_x_minus="below",
    )
    # bars are drawn upwards: the first row comes to the top
    figure.update_yaxes(autorange="reversed")
    html = figure_html(figure, "matter", 160 + 30 * len(bars))
    title = f"{content['case']}: what matters for {content['task']}"
    sections = (PageSection(figure=html), table(content))
    write_plot_page(path, title, content["summary"], sections)
