"""Writing a blind check: ``score.json``, ``score.md`` and ``score.html``, which opens offline."""

from __future__ import annotations

import html
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

_STYLE = (
    "body{font-family:sans-serif;margin:2em auto;max-width:1200px}table{border-collapse:collapse}"
    "td,th{border:1px solid #bbb;padding:.2em .6em;text-align:left}"
)


def write_score(scored: Scored, folder: Path) -> tuple[Path, ...]:
    """Write the figures, the tables and the pictures; each file whole or not at all."""
    places = tuple(folder / f"score.{ending}" for ending in ("json", "md", "html"))
    write_json(
        {**scored.figures, "verdicts": [asdict(case) for case in scored.cases]},
        places[0],
    )
    shown = tables(scored.figures)
    with atomic_write(places[1]) as aside:
        aside.write_text(
            "# Blind check\n\n" + "\n".join(table.markdown() for table in shown),
            encoding="utf-8",
        )
    with atomic_write(places[2]) as aside:
        aside.write_text(_page(scored, shown), encoding="utf-8")
    return places


def _page(scored: Scored, shown: list[Table]) -> str:
    makers = (severity_figure, reliability_figure, confusion_figure)
    pictures = [
        maker(scored.figures).to_html(full_html=False, include_plotlyjs=k == 0)
        for k, maker in enumerate(makers)
    ]
    body = "".join([*map(_table, shown), *pictures])
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Blind check</title>'
        f"<style>{_STYLE}</style></head><body><h1>Blind check</h1>{body}</body></html>"
    )


def _table(table: Table) -> str:
    head = "".join(f"<th>{html.escape(text)}</th>" for text in table.heads)
    rows = (
        "".join(f"<td>{html.escape(text)}</td>" for text in row) for row in table.rows
    )
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return f"<h2>{html.escape(table.title)}</h2><table><tr>{head}</tr>{body}</table>"
