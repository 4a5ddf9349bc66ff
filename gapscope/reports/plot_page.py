"""Pages of figures and tables that need no template of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from gapscope.reports.pages import write_html

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#1f2328")
"""Colours of curves, told apart by colour-blind people too."""
FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", "Liberation Sans", Arial, sans-serif'
"""The font of ``base.css``, for figures."""
INK, GRID, ZERO = "#1f2328", "#e6e9ed", "#aab2bc"
"""Colours of text, grid and zero lines."""


@dataclass(frozen=True)
class PageSection:
    """One section of a page.

    Attributes:
        title: above it, or an empty string.
        note: a sentence under the title, or an empty string.
        figure: as HTML, or ``None``.
        heads: of the columns of a table.
        rows: of the table; a row of two cells, if there are more columns, spans them with its second.
        numbers: whether the cells are numbers, set to the right.
    """

    title: str = ""
    note: str = ""
    figure: Markup | None = None
    heads: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    numbers: bool = True


def write_plot_page(
    path: Path,
    title: str,
    facts: str,
    sections: Sequence[PageSection],
    *,
    whole: bool = False,
) -> None:
    """Write a page of sections.

    Args:
        path: the page.
        title: above it.
        facts: a sentence below that.
        sections: in their order.
        whole: whether figures need more than lines and bars; the page is then 4 MB larger.

    Raises:
        GapscopeError: the file cannot be written.
    """
    write_html(
        "plot_page.html",
        path,
        title=title,
        facts=facts,
        sections=sections,
        whole=whole,
    )


def figure_html(figure: Figure, name: str, height: int, **layout: Any) -> Markup:
    """A plotly figure in the style of the pages, as HTML without plotly's code.

    Args:
        figure: with its traces and titles of axes.
        name: identifies it within the page.
        height: in pixels.
        layout: entries of plotly's layout that differ from those of all pages.
    """
    common: dict[str, Any] = {
        "height": height,
        "font": {"family": FONT, "size": 13, "color": INK},
        "paper_bgcolor": "#fff",
        "plot_bgcolor": "#fff",
        "margin": {"l": 62, "r": 14, "t": 64, "b": 46},
        "legend": {
            "orientation": "h",
            "x": 0,
            "y": 1.06,
            "yanchor": "bottom",
            "xanchor": "left",
        },
    }
    figure.update_layout(**(common | layout))
    figure.update_xaxes(gridcolor=GRID, zerolinecolor=ZERO, automargin=True)
    figure.update_yaxes(gridcolor=GRID, zerolinecolor=ZERO, automargin=True)
    # Buttons named one by one: by default there is one that sends the data to a server.
    config = {
        "responsive": True,
        "displaylogo": False,
        "plotlyServerURL": "",
        "modeBarButtons": [["zoom2d", "pan2d", "resetScale2d", "toImage"]],
    }
    html = figure.to_html(
        full_html=False, include_plotlyjs=False, config=config, div_id=name
    )
    return Markup(html)
