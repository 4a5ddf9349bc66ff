"""Writing a blind check: ``score.json``, ``score.md`` and ``score.html``, which opens offline."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import write_json
from gapscope.blind_check.score import Scored
from gapscope.reports.blind_check.pictures import (
    confusion_figure,
    reliability_figure,
    severity_figure,
)
from gapscope.reports.blind_check.tables import Table, tables
from gapscope.reports.plot_page import PageSection, figure_html, write_plot_page

FIGURES = {
    "severity": ("Single effects over severity", severity_figure, 460),
    "reliability": ("Reliability", reliability_figure, 460),
    "confusion": ("Confusion", confusion_figure, 900),
}
"""Figures by name, each with its title, its maker and its height [pixels]."""


def write_score(scored: Scored, folder: Path) -> tuple[Path, ...]:
    """Write the figures, the tables and the pictures; each file whole or not at all.

    Returns:
        ``score.json``, ``score.md`` and ``score.html``.

    Raises:
        GapscopeError: a file cannot be written.
    """
    document, text, page = (
        folder / f"score.{ending}" for ending in ("json", "md", "html")
    )
    verdicts = [asdict(case) for case in scored.cases]
    write_json({**scored.figures, "verdicts": verdicts}, document)
    shown = tables(scored.figures)
    with atomic_write(text) as aside:
        content = "\n".join(table.markdown() for table in shown)
        aside.write_text(f"# Blind check\n\n{content}", encoding="utf-8")
    _write_page(scored, shown, page)
    return document, text, page


def _write_page(scored: Scored, shown: list[Table], path: Path) -> None:
    sections = [
        PageSection(
            title=table.title, heads=table.heads, rows=table.rows, numbers=False
        )
        for table in shown
    ]
    for name, (title, make_figure, height) in FIGURES.items():
        figure = figure_html(make_figure(scored.figures), name, height)
        sections.append(PageSection(title=title, figure=figure))
    write_plot_page(path, "Blind check", "", sections, whole=True)
