"""Pages: one template environment, one style; every page is one file that opens without a network."""

from __future__ import annotations

from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from gapscope.arm import display
from gapscope.arm.display import effect_name
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.diagnosis.document.wording import acts_on, capital, holds_in


def write_html(template: str, path: Path | str, **content: Any) -> None:
    """Fill a template and write the page.

    Args:
        template: its file, relative to ``gapscope/reports``; it extends ``base.html``.
        path: the page.
        content: what the template shows, by name; text is escaped.

    Raises:
        GapscopeError: ``path`` cannot be written.
    """
    html = render_html(template, **content)
    with atomic_write(path) as aside:
        aside.write_text(html, encoding="utf-8")


def render_html(template: str, **content: Any) -> str:
    """Fill a template, as ``write_html`` does, without a file."""
    return environment().get_template(template).render(**content)


@cache
def environment() -> jinja2.Environment:
    """Templates of all pages with their filters; everything is escaped unless a template file says otherwise."""
    made = jinja2.Environment(
        loader=jinja2.FunctionLoader(_read),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals["embed"] = lambda name: Markup(_read(name))
    made.globals["plotly"] = _plotly
    made.filters |= {
        "nrmse": display.nrmse,
        "percent": display.percent,
        "percent_with_decimal": percent_with_decimal,
        "significant": display.significant,
        "uncertain": display.uncertain,
        "compact": display.compact,
        "three_digits": "{:.3g}".format,
        "unit": _unit,
        "effect_name": effect_name,
        "acts_on": acts_on,
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
    files = resources.files("gapscope.reports")
    return files.joinpath(name).read_text(encoding="utf-8")
