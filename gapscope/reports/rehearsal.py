"""A rehearsal on the terminal and as a page: what was put in, what was named, and the value said."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Group

from gapscope.arm.display import (
    MISSING,
    display_unit,
    effect_name,
    percent,
    uncertain,
)
from gapscope.blind_check.scoring import share
from gapscope.diagnosis.document.numbers import place_text
from gapscope.diagnosis.document.wording import Document
from gapscope.reports.blind_check import rate
from gapscope.reports.pages import (
    COLOURS,
    PLAIN,
    PageSection,
    figure_html,
    subplots,
    write_plot_page,
)

HEADS = (
    "put in",
    "size",
    "of which named",
    "result",
    "newly named",
    "said",
    "probability",
)
"""Of the columns of the table."""
CHANCES = {"half": "half", "nine_of_ten": "nine of ten", "severity": "usual size"}
"""What is expected of a size, in words."""
OUTCOMES = {"found": COLOURS[2], "confused": COLOURS[4], "missed": COLOURS[1]}
"""Results of a diagnosis, and their colours."""


def sentence(rows: Sequence[Document]) -> str:
    """How many effects were found, and how many at the size that should be in nine of ten."""
    counts = [sum(row["outcome"] == key for row in rows) for key in OUTCOMES]
    found, confused, missed = counts
    text = f"Effects put in: {len(rows)}; found: {found}, taken for something else: {confused}, missed: {missed}"
    # at this size the forecast can be held against what was found
    likely = [
        row["outcome"] == "found" for row in rows if row["chance"] == "nine_of_ten"
    ]
    if likely:
        text += (
            f"; of the size that nine of ten should be named at: {rate(share(likely))}"
        )
    return f"{text}."


def table(content: Document) -> PageSection:
    """A row for each effect that was put in."""
    rows = []
    for row in content["rows"]:
        # both in the unit that suits what was put in
        factor, unit = display_unit(row["unit"], row["size"])
        unit = "" if row["unit"] == "1" else f" {unit}"
        said = MISSING
        if row["value"] is not None:
            std = None if row["std"] is None else factor * row["std"]
            said = uncertain(factor * row["value"], std) + unit
        rows.append(
            (
                f"{effect_name(row['effect'])}, {place_text(row['joint'], None)}",
                f"{factor * row['size']:.3g}{unit}",
                CHANCES[row["chance"]],
                row["outcome"],
                "; ".join(row["named"]) or MISSING,
                said,
                percent(row["probability"]),
            )
        )
    return PageSection("Effects put in, one at a time", HEADS, rows)


def as_is(content: Document) -> str:
    """What the recordings name with nothing put in."""
    named = "; ".join(content["as_is"]) or "nothing"
    return f"As they are the recordings name: {named}. That does not count as found."


def summary(content: Document) -> Group:
    """The table with its sentence on a terminal."""
    shown = table(content).on_terminal(**PLAIN)
    return Group(shown, "", content["summary"], as_is(content))


def write_page(content: Document, path: Path) -> None:
    """Write the page: the picture of values said over values put in, and the table.

    Raises:
        GapscopeError: the file cannot be written.
    """
    figure = subplots(1)
    # each outcome is a trace, so that the legend names it
    for outcome, colour in OUTCOMES.items():
        # a diagnosis that failed says no value
        rows = [row for row in content["rows"] if row["outcome"] == outcome]
        places = [
            f"{effect_name(r['effect'])} {r['joint'] or ''}, {CHANCES[r['chance']]}"
            for r in rows
        ]
        errors = [1.96 * (row["std"] or 0.0) / row["size"] for row in rows]
        figure.add_scatter(
            x=[(row["value"] or 0.0) / row["size"] for row in rows],
            y=places,
            error_x={"type": "data", "array": errors},
            mode="markers",
            marker={"color": colour, "size": 9},
            name=outcome,
        )
    # a value that is right lies on this line
    figure.add_vline(x=1.0, line_dash="dot")
    figure.update_xaxes(
        title="value said, with its 95 % interval, over what was put in"
    )
    drawn = figure_html(figure, "rehearsal", 180 + 24 * len(content["rows"]))
    sections = (PageSection(note=as_is(content), figure=drawn), table(content))
    write_plot_page(path, f"{content['case']}: rehearsal", content["summary"], sections)
