"""An agreement as a page with the values of each recording that opens without a network."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from gapscope.reports.agreement.lines import (
    RELATIVE,
    Line,
    differing,
    heading,
    sentences,
    trusted,
    unit,
    values,
)
from gapscope.reports.plot_page import (
    COLOURS,
    PageSection,
    figure_html,
    write_plot_page,
)

if TYPE_CHECKING:
    from plotly.graph_objects import Figure, Scatter

COLUMNS = 3
"""Panels beside one another."""
PANEL_HEIGHT = 190
"""Height of a row of panels [pixels]."""
MOST_PANELS = 60
"""Most panels; the table has all parameters."""
MOST_WIDTH = 44
"""Longest title of a panel [characters]."""


def write_page(content: dict[str, Any], path: Path) -> None:
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
        numbers=False,
    )
    write_plot_page(
        path,
        f"Do the recordings of {content['case']} agree?",
        _facts(content),
        [*_differences(content), _panels(content), table],
    )


def _facts(content: dict[str, Any]) -> str:
    """How many parameters agree, and at which rate one that agrees is said to differ."""
    rate = content["false_alarm_rate"]
    return (
        f"{heading(content)} Of arms that are the same in all recordings {rate:.0%} have a parameter that is said to "
        f"differ. Friction: {content['friction_law']}."
    )


def _differences(content: dict[str, Any]) -> list[PageSection]:
    """A section for each parameter that differs."""
    return [
        PageSection(title=_differs(line), note=". ".join(sentences(line)))
        for line in differing(content)
    ]


def _panels(content: dict[str, Any]) -> PageSection:
    """A panel for each parameter, those that differ first, with a bar of two deviations for each recording."""
    lines = [one for one in content["parameters"] if one["birge"] is not None]
    shown = lines[:MOST_PANELS]
    figure = None
    if shown:
        rows = -(-len(shown) // COLUMNS)  # rounded up
        drawn = _figure(shown, content["recordings"], rows)
        height = 60 + PANEL_HEIGHT * rows
        figure = figure_html(drawn, "agreement", height, showlegend=False)
    return PageSection(
        title="Values by recording",
        note="Bars of two standard deviations; what differs is orange, the band is the value to trust.",
        figure=figure or Markup(""),
    )


def _figure(lines: list[Line], recordings: list[str], rows: int) -> Figure:
    from plotly.subplots import make_subplots

    gap = min(0.35 / rows, 0.12)
    titles = [_title(line) for line in lines]
    figure = make_subplots(
        rows=rows, cols=COLUMNS, subplot_titles=titles, vertical_spacing=gap
    )
    for place, line in enumerate(lines):
        row, column = divmod(place, COLUMNS)
        where = {"row": row + 1, "col": column + 1}
        value = line["trusted"]
        if value is not None:
            low, high = (value["value"] + k * value["std"] for k in (-2.0, 2.0))
            figure.add_hrect(
                y0=low,
                y1=high,
                fillcolor=COLOURS[2],
                opacity=0.15,
                line_width=0,
                **where,
            )
        figure.add_trace(_bars(line, recordings), **where)
    figure.update_annotations(font_size=12)
    numbers = list(range(1, len(recordings) + 1))
    figure.update_xaxes(tickvals=numbers, range=[0.5, len(recordings) + 0.5])
    return figure


def _bars(line: Line, recordings: list[str]) -> Scatter:
    """The value in each recording that determines it, over the recording's number."""
    from plotly.graph_objects import Scatter

    known = [k for k, std in enumerate(line["std"]) if std is not None]
    colour = COLOURS[1] if line["verdict"] == "differs" else COLOURS[0]
    return Scatter(
        x=[k + 1 for k in known],
        y=[line["values"][k] for k in known],
        error_y={"type": "data", "array": [2.0 * line["std"][k] for k in known]},
        text=[recordings[k] for k in known],
        mode="markers",
        marker={"color": colour, "size": 8},
    )


def _title(line: Line) -> str:
    """Name and unit of a parameter, short enough for a panel."""
    name = line["name"]
    if len(name) > MOST_WIDTH:
        name = name[: MOST_WIDTH - 1] + "…"
    return f"{name} [{unit(line) or '1'}]"


def _differs(line: Line) -> str:
    """Heading of a parameter that differs."""
    words = f"{line['name']} differs"
    return words[0].upper() + words[1:]
