"""Pages: one template environment, one style, sections; every page is one file that opens without a network."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jinja2
import numpy as np
from markupsafe import Markup
from rich import box
from rich.table import Table
from rich.text import Text

from gapscope.arm import display
from gapscope.arm.display import effect_name
from gapscope.arm.io.atomic_write import write_text
from gapscope.diagnosis.document.wording import (
    acts_on,
    capital,
    holds_in,
    parameter_texts,
)

if TYPE_CHECKING:
    import pandas as pd
    from plotly.graph_objects import Figure

# Pages: one template environment, one style; every page is one file that opens without a network.


def write_html(template: str, path: Path | str, **content: Any) -> None:
    """Fill a template and write the page.

    Args:
        template: its file, relative to ``gapscope/reports/templates``; it extends ``base.html``.
        path: the page.
        content: what the template shows, by name; text is escaped.

    Raises:
        GapscopeError: ``path`` cannot be written.
    """
    write_text(path, render_html(template, **content))


def render_html(template: str, **content: Any) -> str:
    """Fill a template, as ``write_html`` does, without a file."""
    return environment().get_template(template).render(**content)


@cache
def environment() -> jinja2.Environment:
    """Templates of all pages with their filters; everything is escaped unless a template file says otherwise."""
    made = jinja2.Environment(
        loader=jinja2.FunctionLoader(_read),
        # names of cases, joints and files come from others
        autoescape=True,
        # a name that a template lacks is an error, not a blank
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # scripts and styles of the package itself need no escaping
    made.globals["embed"] = lambda name: Markup(_read(name))
    made.globals["plotly"] = _plotly
    made.filters |= {
        "nrmse": display.nrmse,
        "percent": display.percent,
        "percent_with_decimal": percent_with_decimal,
        "significant": display.significant,
        "uncertain": display.uncertain,
        "compact": display.compact,
        "unit": _unit,
        "effect_name": effect_name,
        "acts_on": acts_on,
        "parameter_texts": parameter_texts,
        "holds_in": holds_in,
        "capital": capital,
    }
    return made


def percent_with_decimal(fraction: float | None) -> str:
    """A share [1] in percent with one decimal."""
    return display.MISSING if fraction is None else f"{100 * fraction:.1f} %"


def _unit(unit: str) -> str:
    """A unit as it is shown; rad stays, since it is not the unit of a value here."""
    return unit if unit in ("1", "rad") else display.display_unit(unit, 1.0)[1]


def _plotly(whole: bool = False) -> Markup:
    """The script that draws figures: lines and bars alone, or the whole, which is four times as large."""
    if not whole:
        return Markup(_read("vendor/plotly-basic.min.js"))
    from plotly.offline import get_plotlyjs  # several MB of text, needed only here

    return Markup(get_plotlyjs())


def _read(name: str) -> str:
    files = resources.files("gapscope.reports") / "templates"
    return files.joinpath(name).read_text(encoding="utf-8")


# Pages of figures and tables that need no template of their own.


COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#1f2328")
"""Colours of curves, told apart by colour-blind people too."""
FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", "Liberation Sans", Arial, sans-serif'
"""The font of ``base.css``, for figures."""
INK, GRID, ZERO = "#1f2328", "#e6e9ed", "#aab2bc"
"""Colours of text, grid and zero lines."""


@dataclass(frozen=True)
class PageSection:
    """One section of a page: a table, a figure, or a sentence; a table also for a terminal or as Markdown.

    Attributes:
        title: above it, or an empty string.
        heads: of the columns of a table.
        rows: of the table.
        note: a sentence under the title, or an empty string.
        figure: as HTML, or ``None``.
        numbers: whether the cells are numbers, set to the right.
    """

    title: str = ""
    heads: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    note: str = ""
    figure: Markup | None = None
    numbers: bool = False

    def markdown(self) -> str:
        """The table as Markdown."""
        rule = "|" + "---|" * len(self.heads)
        rows = ["| " + " | ".join(row) + " |" for row in (self.heads, *self.rows)]
        return "\n".join([f"### {self.title}", "", rows[0], rule, *rows[1:]]) + "\n"

    def on_terminal(self, **style: Any) -> Table:
        """The table on a terminal, its texts to the left and numbers to the right."""
        # as plain text: brackets in names are no markup
        texts = [[Text(cell, overflow="fold") for cell in row] for row in self.rows]
        left = 1 if self.numbers else len(self.heads)
        return terminal_table(self.heads, texts, left, title=self.title, **style)


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


def subplots(rows: int, columns: int = 1, **options: Any) -> Figure:
    """A figure of plotly with panels, which is imported only then."""
    from plotly.subplots import make_subplots

    return make_subplots(rows=rows, cols=columns, **options)


@dataclass(frozen=True)
class Panel:
    """A curve for each joint over one abscissa.

    Attributes:
        title: of the ordinate, with its unit.
        x: time [s] or frequency [Hz], (M,).
        curves: (M, n).
        spectrum: whether the abscissa is a frequency; both axes are then logarithmic.
    """

    title: str
    x: np.ndarray
    curves: np.ndarray
    spectrum: bool = False

    @property
    def abscissa(self) -> str:
        """Title of the abscissa."""
        return "frequency [Hz]" if self.spectrum else "time [s]"


def panels_figure(
    panels: Sequence[Panel], joints: Sequence[str], **options: Any
) -> Figure:
    """Panels one above the other; colours repeat, dashed, after the last one.

    Args:
        panels: what is drawn.
        joints: their names, in the legend.
        options: of plotly's subplots; with ``shared_xaxes`` the last panel alone has a title below it.
    """
    figure = subplots(len(panels), **options)
    for row, panel in enumerate(panels, start=1):
        x = _rounded(panel.x)
        for j, curve in enumerate(panel.curves.T):
            figure.add_scatter(
                x=x,
                y=_rounded(curve),
                name=joints[j],
                legendgroup=str(j),
                # one entry for a joint, which switches it in all panels
                showlegend=row == 1,
                line={
                    "color": COLOURS[j % len(COLOURS)],
                    "width": 1.4,
                    "dash": "solid" if j < len(COLOURS) else "dash",
                },
                mode="lines",
                row=row,
                col=1,
            )
        kind = "log" if panel.spectrum else "linear"
        title = {"text": panel.title, "standoff": 8}
        figure.update_yaxes(title=title, type=kind, row=row, col=1)
        figure.update_xaxes(type=kind, row=row, col=1)
        if row == len(panels) or not options.get("shared_xaxes"):
            below = {"text": panel.abscissa, "standoff": 2}
            figure.update_xaxes(title=below, row=row, col=1)
    return figure


def drawn(kind: str, rows: Any, axes: Mapping[str, str], **style: Any) -> Figure:
    """A figure of plotly express in the colours of the pages.

    Args:
        kind: ``scatter``, ``line``, ``bar`` or ``box``.
        rows: a data frame, or what makes one.
        axes: the columns on x and y, each with its title.
        style: of plotly express: which other column is drawn as what.
    """
    import plotly.express as px

    if kind in ("scatter", "line"):
        # the script of lines and bars has no WebGL, which many points would get
        style["render_mode"] = "svg"
    places = dict(zip("xy", axes, strict=True))
    colours = {"color_discrete_sequence": COLOURS}
    figure = getattr(px, kind)(rows, **places, labels=axes, **(colours | style))
    figure.update_layout(legend_title_text="")
    # a panel is named by a value, without the name of its column
    figure.for_each_annotation(lambda note: note.update(text=note.text.split("=")[-1]))
    return figure


def with_bars(rows: Any, factor: float = 1.0) -> pd.DataFrame:
    """Rows with value, low and high times a factor, and the lengths of bars to both ends, above and below."""
    import pandas as pd  # not needed by all pages

    frame = pd.DataFrame(rows)
    low, value, high = (
        factor * frame[k].astype(float) for k in ("low", "value", "high")
    )
    return frame.assign(value=value, above=high - value, below=value - low)


def _rounded(values: np.ndarray) -> list[float]:
    """Five significant digits: a page should stay small."""
    return [float(f"{value:.5g}") for value in values]


def figure_html(
    figure: Figure, name: str, height: int, legend_at: float = 1.06, **layout: Any
) -> Markup:
    """A plotly figure in the style of the pages, as HTML without plotly's code.

    Args:
        figure: with its traces and titles of axes.
        name: identifies it within the page.
        height: in pixels.
        legend_at: lower edge of the legend over the height of the drawing [1].
        layout: entries of plotly's layout that differ from those of all pages.
    """
    common = {
        "height": height,
        "font": {"family": FONT, "size": 13, "color": INK},
        "paper_bgcolor": "#fff",
        "plot_bgcolor": "#fff",
        "margin": {"l": 62, "r": 14, "t": 64, "b": 46},
        "legend": {
            "orientation": "h",
            "x": 0,
            "y": legend_at,
            "yanchor": "bottom",
            "xanchor": "left",
        },
    }
    figure.update_layout(**(common | layout))
    for axes in (figure.update_xaxes, figure.update_yaxes):
        axes(gridcolor=GRID, zerolinecolor=ZERO, automargin=True)
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


# A table of a terminal.


PLAIN: dict[str, Any] = {
    "box": box.SIMPLE_HEAD,
    "show_edge": False,
    "padding": (0, 1, 0, 0),
}
"""Style of a table with a line under its heads alone."""


def terminal_table(
    heads: Sequence[str],
    rows: Iterable[Sequence[str | Text]],
    left: int = 1,
    whole: slice = slice(0),
    **style: Any,
) -> Table:
    """A table of texts: its first columns to the left, numbers of the others to the right.

    Args:
        heads: of the columns.
        rows: their cells.
        left: how many columns are set to the left.
        whole: columns whose cells stay on one line; the others take what is left of the width.
        style: of ``rich.table.Table``.
    """
    table = Table(**{"title_justify": "left", **style})
    for k, head in enumerate(heads):
        table.add_column(Text(head), justify="left" if k < left else "right")
    for column in table.columns[whole]:
        column.no_wrap = True
    for row in rows:
        table.add_row(*row)
    return table
