"""A fleet as a page and on the terminal: what changed, which units are worst, what units share."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from rich.console import Group
from rich.table import Table
from rich.text import Text

from gapscope.arm.display import display_unit, effect_name, nrmse, percent, uncertain
from gapscope.diagnosis.document.numbers import place_text
from gapscope.diagnosis.document.wording import VERDICTS, capital
from gapscope.reports.pages import write_html

# A fleet in words: its headline, places of effects, values and changes.


Entry = Mapping[str, Any]


def headline(content: Entry) -> str:
    """What a fleet's document says, in one sentence."""
    units = _count(content["units"], "unit")
    cases = _count(content["cases"], "case")
    changed = len({change["unit"] for change in content["changes"]})
    what = f"{_count(changed, 'unit')} changed" if changed else "no unit changed"
    failed = (
        f"; {_count(content['failed'], 'case')} failed" if content["failed"] else ""
    )
    return f"{units} in {cases}: {what}{failed}"


def value_words(value: float, std: float | None, unit: str) -> str:
    """A value with its deviation in a readable unit."""
    factor, shown = display_unit(unit, abs(value))
    text = uncertain(factor * value, None if std is None else factor * std)
    return f"{text} {shown}".strip()


def change_words(change: Entry) -> str:
    """What changed, from what to what."""
    before, after = change["before"], change["after"]
    if change["kind"] != "value":
        shares = f"{percent(before['value'])} to {percent(after['value'])}"
        return f"{change['kind']}: named in {shares} of the diagnoses"
    name = f"{change['parameter'].replace('_', ' ')} {change['component']}".strip()
    values = [
        value_words(v["value"], v["std"], change["si_unit"]) for v in (before, after)
    ]
    return f"{name} from {values[0]} to {values[1]}"


def change_line(change: Entry) -> str:
    """A change as a line of the terminal."""
    effect = capital(effect_name(change["effect"]))
    dates = f"between {change['last_before']} and {change['first_after']}"
    where = place_text(change["joint"], change["link"])
    return f"{change['unit']}: {effect}, {where}, {change_words(change)}, {dates}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


# A history as a small drawing: points with intervals, and the means before and after its change.


WIDTH, HEIGHT, EDGE = 220, 46, 4
"""Size of the drawing and its margin [pixels]."""
INTERVAL = 1.96
"""Standard deviations to each side of an interval of 95 % [1]."""


def sparkline(change: Mapping[str, Any]) -> Markup:
    """The history of a change as SVG, in colours of the page."""
    points = change["history"]
    days = [date.fromisoformat(point["date"]).toordinal() for point in points]
    value, std = (
        np.array([point[key] or 0.0 for point in points]) for key in ("value", "std")
    )
    means = np.array([change[key]["value"] for key in ("before", "after")])
    x = _scaled(np.array(days, float), WIDTH)
    # upwards on the screen is downwards in its coordinates
    drawn = np.concatenate(
        [value, value - INTERVAL * std, value + INTERVAL * std, means]
    )
    y = HEIGHT - _scaled(drawn, HEIGHT)
    middle, low, high = y[: 3 * len(x)].reshape(3, -1)
    bars = [f"M{a:.1f} {b:.1f}V{c:.1f}" for a, b, c in zip(x, low, high, strict=True)]
    parts = [f'<path class="bars" d="{" ".join(bars)}"/>']
    for a, b in zip(x, middle, strict=True):
        parts.append(f'<circle cx="{a:.1f}" cy="{b:.1f}" r="2"/>')
    split = sum(point["date"] <= change["last_before"] for point in points)
    spans = (x[: max(split, 1)], x[min(split, len(x) - 1) :])
    for level, own in zip(y[-2:], spans, strict=True):
        line = f"M{own[0] - 2:.1f} {level:.1f}H{own[-1] + 2:.1f}"
        parts.append(f'<path class="mean" d="{line}"/>')
    label = f"{len(points)} diagnoses, {points[0]['date']} to {points[-1]['date']}"
    # all parts are numbers and dates
    return Markup(
        f'<svg class="sparkline" role="img" aria-label="{label}" width="{WIDTH}" height="{HEIGHT}">'
        f"<title>{label}</title>{''.join(parts)}</svg>"
    )


def _scaled(numbers: np.ndarray, size: int) -> np.ndarray:
    """Numbers as pixels from one margin to the other; in the middle if all are the same."""
    least, most = numbers.min(), numbers.max()
    if most == least:
        return np.full(len(numbers), size / 2)
    return EDGE + (size - 2 * EDGE) / (most - least) * (numbers - least)


# The page of a fleet: ``fleet.html``.


REPORT, DOCUMENT = "report.html", "diagnosis.json"
KINDS = {
    "shared": "on all units, alike",
    "shared_differing_size": "on all units, of different size",
    "some_units": "on some units",
    "one_unit": "on one unit",
}


def render_fleet(content: Mapping[str, Any], path: Path, *, reports: bool) -> None:
    """Write the page.

    Args:
        content: of ``fleet.json``.
        path: the page, in the folder of the results.
        reports: whether diagnoses were kept with their reports, which are linked then.

    Raises:
        GapscopeError: ``path`` cannot be written.
    """
    write_html(
        "fleet/fleet.html",
        path,
        fleet=content,
        headline=headline(content),
        kinds=KINDS,
        verdicts=VERDICTS,
        place=place_text,
        change_words=change_words,
        value_words=value_words,
        sparkline=sparkline,
        false_share=percent(content["false_share"]),
        linked=REPORT if reports else DOCUMENT,
    )


# A fleet on the terminal: what changed, and the worst units.


SHOWN = 10
"""Changes and units that are shown [1]."""


def summary(content: Mapping[str, Any]) -> Group:
    """The first lines of ``fleet.json``."""
    lines = [capital(headline(content))]
    lines += [change_line(change) for change in content["changes"][:SHOWN]]
    worst = [_worst(content)] if content["worst"] else []
    return Group(*map(Text, lines), *worst)


def _worst(content: Mapping[str, Any]) -> Table:
    table = Table("unit", "last", "verdict", "effects", "gap above floor", box=None)
    for row in content["worst"][:SHOWN]:
        effects = ", ".join(effect_name(effect) for effect in row["effects"])
        verdict = VERDICTS[row["verdict"]]
        table.add_row(row["unit"], row["date"], verdict, effects, nrmse(row["excess"]))
    return table
