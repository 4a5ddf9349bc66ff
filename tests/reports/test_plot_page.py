"""Pages of figures and tables: one file that loads nothing, with text escaped and figures in one style."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from plotly.graph_objects import Figure

from gapscope.reports.pages import (
    PageSection,
    figure_html,
    percent_with_decimal,
    write_plot_page,
)

EVIL = "<script>alert('x')</script>"


@pytest.fixture
def figure() -> Figure:
    made = Figure()
    made.add_scatter(x=[0.0, 1.0], y=[2.0, 3.0])
    return made


def body(path: Path) -> str:
    """What lies below the head, without plotly's own code."""
    return path.read_text(encoding="utf-8").partition("<body>")[2]


def test_one_file_that_loads_nothing(figure: Figure, tmp_path: Path) -> None:
    path = tmp_path / "deep" / "page.html"
    section = PageSection(figure=figure_html(figure, "drawn", 300))
    write_plot_page(path, "A title", "Some facts.", [section])
    html = path.read_text(encoding="utf-8")
    assert html.startswith("<!DOCTYPE html>") and "default-src 'none'" in html
    assert not re.search(r"<(script|img|link|iframe)[^>]*(src|href)=", html)
    assert "Plotly.newPlot" in body(path) and 'id="drawn"' in body(path)
    assert [file.name for file in path.parent.iterdir()] == ["page.html"]


def test_text_is_escaped(tmp_path: Path) -> None:
    section = PageSection(EVIL, (EVIL,), [(EVIL,)], EVIL)
    write_plot_page(tmp_path / "page.html", EVIL, EVIL, [section])
    html = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert EVIL not in html and html.count("&lt;script&gt;alert") == 7


def test_tables_of_numbers_and_of_text(tmp_path: Path) -> None:
    tables = [PageSection("", ("x",), [("a",)], numbers=of) for of in (True, False)]
    write_plot_page(tmp_path / "page.html", "t", "", tables)
    shown = body(tmp_path / "page.html")
    assert re.findall(r'class="(numbers|texts)"', shown) == ["numbers", "texts"]


def test_figures_have_one_style_and_no_button_that_sends_data(figure: Figure) -> None:
    html = figure_html(figure, "drawn", 300, hovermode="x unified")
    assert figure.layout.height == 300 and figure.layout.hovermode == "x unified"
    assert re.search(r'"displaylogo":\s*false', html) and "plot.ly" not in html
    assert "toImage" in html and "sendDataToCloud" not in html


@pytest.mark.parametrize(
    ("fraction", "text"), [(0.0123, "1.2 %"), (1.0, "100.0 %"), (None, "–")]
)
def test_a_share_with_one_decimal(fraction: float | None, text: str) -> None:
    assert percent_with_decimal(fraction) == text
