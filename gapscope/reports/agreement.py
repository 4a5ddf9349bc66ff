"""An agreement as a page and on the terminal: what differs, what goes with it, the value to trust."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup
from rich.console import Group
from rich.text import Text

from gapscope.arm.display import MISSING, uncertain, unit_name
from gapscope.diagnosis.document.wording import Document, capital
from gapscope.reports.pages import (
    COLOURS,
    PLAIN,
    PageSection,
    figure_html,
    subplots,
    terminal_table,
    write_plot_page,
)

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# An agreement as a page and on the terminal: what differs, what goes with it, and the value to trust.


# What table and page of an agreement share: numbers and sentences of its document.


RELATIVE = "Friction is that of each recording; all else counts from the first one."
"""What is to be known of the values."""


def heading(content: Document) -> str:
    """How many parameters agree, differ and are not determined, in one sentence."""
    verdicts = [line["verdict"] for line in content["parameters"]]
    agree, differ = map(verdicts.count, ("agrees", "differs"))
    text = (
        f"{len(content['recordings'])} recordings, {len(verdicts)} parameters: {agree} agree, "
        f"{differ} differ"
    )
    # the third verdict is said only if some have it
    rest = len(verdicts) - agree - differ
    return f"{text}, {rest} not determined by two recordings." if rest else f"{text}."


def with_unit(value: str, line: Document) -> str:
    """A value as text with its unit; a dash stays alone."""
    return value if value == MISSING else f"{value} {unit(line)}".rstrip()


def differing(content: Document) -> list[Document]:
    """Parameters that differ, the strongest first."""
    return [line for line in content["parameters"] if line["verdict"] == "differs"]


def trusted(line: Document) -> str:
    """The value to trust, with its deviation."""
    value = line["trusted"]
    return MISSING if value is None else uncertain(value["value"], value["std"])


def values(line: Document) -> list[str]:
    """The value in each recording; a dash if it does not determine the parameter."""
    pairs = zip(line["values"], line["std"], strict=True)
    return [MISSING if std is None else uncertain(x, std) for x, std in pairs]


def unit(line: Document) -> str:
    """SI unit of the values, as it is shown; empty for a ratio."""
    return unit_name(line["unit"])


def sentences(line: Document) -> Iterator[str]:
    """What a difference goes with, what would settle it, and what it may be instead."""
    yield f"goes with: {line['goes_with']['text']}"
    yield f"to settle it: {line['settled_by']}"
    if line["alternatives"]:
        yield f"may as well be: {', '.join(line['alternatives'])}"


# An agreement as a page with the values of each recording that opens without a network.


COLUMNS = 3
"""Panels beside one another."""
PANEL_HEIGHT = 190
"""Height of a row of panels [pixels]."""
MAX_PANELS = 60
"""Most panels; the table has all parameters."""
MAX_WIDTH = 44
"""Longest title of a panel [characters]."""


def write_page(content: Document, path: Path) -> None:
    """Write the differences, the values of each recording with bars, and the table of all parameters.

    Args:
        content: the document.
        path: the page.

    Raises:
        GapscopeError: the file cannot be written.
    """
    recordings = content["recordings"]
    table = PageSection(
        title="All parameters",
        note="Value in each recording ± its standard deviation; – if the recording does not determine it. "
        f"{RELATIVE}",
        heads=("parameter", "unit", "verdict", "to trust", *recordings),
        rows=[
            (line["name"], unit(line), line["verdict"], trusted(line), *values(line))
            for line in content["parameters"]
        ],
    )
    facts = f"{heading(content)} Friction: {content['friction_law']}."
    # A panel for each parameter, those that differ first, with a bar of two deviations for each recording
    lines = [one for one in content["parameters"] if one["birge"] is not None]
    shown, figure = lines[:MAX_PANELS], Markup("")
    if shown:
        rows = -(-len(shown) // COLUMNS)  # rounded up
        drawn = _figure(shown, recordings, rows)
        height = 60 + PANEL_HEIGHT * rows
        figure = figure_html(drawn, "agreement", height, showlegend=False)
    panels = PageSection(
        title="Values by recording",
        note="Bars of two standard deviations; what differs is orange, the band is the value to trust.",
        figure=figure,
    )
    # A section for each parameter that differs
    write_plot_page(
        path,
        f"Do the recordings of {content['case']} agree?",
        facts,
        [
            *(
                PageSection(
                    title=capital(f"{line['name']} differs"),
                    note=". ".join(sentences(line)),
                )
                for line in differing(content)
            ),
            panels,
            table,
        ],
    )


def _figure(lines: list[Document], recordings: list[str], rows: int) -> Figure:
    figure = subplots(
        rows,
        COLUMNS,
        subplot_titles=[_title(line) for line in lines],
        vertical_spacing=min(0.35 / rows, 0.12),
    )
    for place, line in enumerate(lines):
        where = {"row": place // COLUMNS + 1, "col": place % COLUMNS + 1}
        # only a parameter that agrees has a value to trust
        value = line["trusted"]
        if value is not None:
            low, high = (value["value"] + k * value["std"] for k in (-2.0, 2.0))
            band = {"fillcolor": COLOURS[2], "opacity": 0.15, "line_width": 0}
            figure.add_hrect(y0=low, y1=high, **band, **where)
        # recordings that do not determine the parameter are left out
        known = [k for k, std in enumerate(line["std"]) if std is not None]
        colour = COLOURS[1] if line["verdict"] == "differs" else COLOURS[0]
        figure.add_scatter(
            x=[k + 1 for k in known],
            y=[line["values"][k] for k in known],
            error_y={"type": "data", "array": [2.0 * line["std"][k] for k in known]},
            text=[recordings[k] for k in known],
            mode="markers",
            marker={"color": colour, "size": 8},
            **where,
        )
    figure.update_annotations(font_size=12)
    numbers = list(range(1, len(recordings) + 1))
    # recordings by number: their names are too long for an axis
    figure.update_xaxes(tickvals=numbers, range=[0.5, len(recordings) + 0.5])
    return figure


def _title(line: Document) -> str:
    """Name and unit of a parameter, short enough for a panel."""
    name = line["name"]
    if len(name) > MAX_WIDTH:
        name = name[: MAX_WIDTH - 1] + "…"
    return f"{name} [{unit(line) or '1'}]"


# An agreement on the terminal: one line per parameter, and what is to be said of those that differ.


STYLES = {"differs": "bold red", "not determined": "dim"}
"""Style of a verdict."""


def summary(content: Document) -> Group:
    """The table of all parameters, then the differences with what goes with them."""
    rows = [
        (
            Text(line["name"], overflow="fold"),
            Text(line["verdict"], STYLES.get(line["verdict"], "")),
            with_unit(trusted(line), line),
        )
        for line in content["parameters"]
    ]
    table = terminal_table(
        ("parameter", "verdict", "to trust"),
        rows,
        2,
        # names may fold
        slice(1, None),
        title=f"{content['case']}: {heading(content)}",
        caption=RELATIVE,
        caption_justify="left",
        **PLAIN,
    )
    texts = []
    # recordings that do not determine some parameters
    for k, recording in enumerate(content["recordings"]):
        # below one the recording leaves the value as it was before
        names = [x["name"] for x in content["parameters"] if x["information"][k] < 1.0]
        if names:
            texts.append(f"\n{recording} does not determine: {'; '.join(names)}")
    for line in differing(content):
        pairs = zip(content["recordings"], values(line), strict=True)
        by_recording = [f"{name} {with_unit(value, line)}" for name, value in pairs]
        texts.append(f"\n{line['name']} differs: {', '.join(by_recording)}")
        texts += [f"  {text}" for text in sentences(line)]
    return Group(table, *map(Text, texts))
