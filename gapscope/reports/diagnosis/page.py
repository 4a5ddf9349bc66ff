"""Renders a diagnosis into one self-contained HTML file."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from importlib import resources
from pathlib import Path

import jinja2
from markupsafe import Markup

from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import plain
from gapscope.diagnosis import display
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.document.wording import acts_on, capital, effect_name
from gapscope.diagnosis.result import Diagnosis
from gapscope.reports.diagnosis import figures, sections
from gapscope.reports.diagnosis.sides_section import sides


def render(diagnosis: Diagnosis, path: Path | str) -> None:
    """Write the report of a diagnosis; the file loads nothing from elsewhere.

    Raises:
        GapscopeError: the document is not valid, or ``path`` cannot be written.
    """
    from plotly.offline import get_plotlyjs  # several MB of text, needed only here

    validate(diagnosis.document)
    diagnosis = replace(diagnosis, document=plain(diagnosis.document))
    html = (
        environment()
        .get_template("report.html")
        .render(
            plotly=Markup(get_plotlyjs()),
            curves=figures.payload(diagnosis),
            document=diagnosis.document,
            **{
                section.__name__: section(diagnosis)
                for section in (*sections.SECTIONS, sides)
            },
        )
    )
    with atomic_write(path) as aside:
        aside.write_text(html, encoding="utf-8")


@cache
def environment() -> jinja2.Environment:
    """Templates of the report with their filters; everything is escaped unless a template file says otherwise."""
    made = jinja2.Environment(
        loader=jinja2.FunctionLoader(_read),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals["embed"] = lambda name: Markup(_read(name))
    made.filters |= {
        "nrmse": display.nrmse,
        "percent": display.percent,
        "significant": display.significant,
        "compact": display.compact,
        "effect_name": effect_name,
        "acts_on": acts_on,
        "capital": capital,
    }
    return made


def _read(name: str) -> str:
    return (
        resources.files("gapscope.reports.diagnosis")
        .joinpath(name)
        .read_text(encoding="utf-8")
    )
