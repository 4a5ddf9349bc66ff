"""Renders an identification into one self-contained HTML file, in the style of the diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import plain
from gapscope.diagnosis import display
from gapscope.ident.identification import Identification
from gapscope.reports.identification import examined, figures, sections


def render(
    result: Identification, document: Mapping[str, Any], path: Path | str
) -> None:
    """Write the report; the file loads nothing from elsewhere.

    Args:
        result: what was identified, for the curves.
        document: its document, for the tables.
        path: of the file.

    Raises:
        GapscopeError: ``path`` cannot be written.
    """
    from plotly.offline import get_plotlyjs  # several MB of text, needed only here

    content = plain(document, null_if_not_finite=True)
    html = (
        _environment()
        .get_template("report.html")
        .render(
            plotly=Markup(get_plotlyjs()),
            curves=figures.payload(result),
            document=content,
            heading=sections.heading(content),
            joints=sections.joints(content),
            friction=sections.friction(content),
            links=sections.links(content),
            shown=examined.identifiability(content),
            intervals=examined.intervals(content),
            found=[
                row for row in content["troubleshooting"] if row["verdict"] == "found"
            ],
        )
    )
    with atomic_write(path) as aside:
        aside.write_text(html, encoding="utf-8")


@cache
def _environment() -> jinja2.Environment:
    made = jinja2.Environment(
        loader=jinja2.FunctionLoader(_read),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals["embed"] = lambda name: Markup(_read(name))
    made.filters |= {
        "percent": sections.percent,
        "significant": display.significant,
        "uncertain": display.uncertain,
        "unit": lambda unit: (
            display.display_unit(unit, 1.0)[1] if unit not in ("1", "rad") else unit
        ),
    }
    return made


def _read(name: str) -> str:
    package = (
        "gapscope.reports.diagnosis"
        if name == "report.css"
        else "gapscope.reports.identification"
    )
    return resources.files(package).joinpath(name).read_text(encoding="utf-8")
