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
    drawn,
    figure_html,
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
    rows = [
        {
            "outcome": row["outcome"],
            "place": f"{effect_name(row['effect'])} {row['joint'] or ''}, {CHANCES[row['chance']]}",
            # a diagnosis that failed says no value
            "said": (row["value"] or 0.0) / row["size"],
            "bar": 1.96 * (row["std"] or 0.0) / row["size"],
        }
        for row in content["rows"]
    ]
    title = "value said, with its 95 % interval, over what was put in"
    figure = drawn(
        "scatter",
        rows,
        {"said": title, "place": ""},
        error_x="bar",
        color="outcome",
        color_discrete_map=OUTCOMES,
        category_orders={"outcome": list(OUTCOMES)},
    )
    figure.update_traces(marker_size=9)
    # a value that is right lies on this line
    figure.add_vline(x=1.0, line_dash="dot")
    html = figure_html(figure, "rehearsal", 180 + 24 * len(rows))
    sections = (PageSection(note=as_is(content), figure=html), table(content))
    write_plot_page(path, f"{content['case']}: rehearsal", content["summary"], sections)
