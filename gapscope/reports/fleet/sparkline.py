"""A history as a small drawing: points with intervals, and the means before and after its change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date
from typing import Any

from markupsafe import Markup

WIDTH, HEIGHT, EDGE = 220, 46, 4
"""Size of the drawing and its margin [pixels]."""
INTERVAL = 1.96
"""Standard deviations to each side of an interval of 95 % [1]."""


def sparkline(change: Mapping[str, Any]) -> Markup:
    """The history of a change as SVG, in colours of the page."""
    points = change["history"]
    days = [date.fromisoformat(point["date"]).toordinal() for point in points]
    x = _scaled(days, WIDTH)
    reach = [INTERVAL * (point["std"] or 0.0) for point in points]
    values = [point["value"] for point in points]
    low = [value - r for value, r in zip(values, reach, strict=True)]
    high = [value + r for value, r in zip(values, reach, strict=True)]
    means = [change["before"]["value"], change["after"]["value"]]
    # upwards on the screen is downwards in its coordinates
    y = [HEIGHT - v for v in _scaled([*values, *low, *high, *means], HEIGHT)]
    count = len(points)
    bars = zip(x, y[count : 2 * count], y[2 * count : 3 * count], strict=True)
    parts = [
        f'<path class="bars" d="{" ".join(f"M{a:.1f} {b:.1f}V{c:.1f}" for a, b, c in bars)}"/>'
    ]
    parts += [
        f'<circle cx="{a:.1f}" cy="{b:.1f}" r="2"/>' for a, b in zip(x, y, strict=False)
    ]
    split = sum(point["date"] <= change["last_before"] for point in points)
    spans = ((0, max(split - 1, 0)), (min(split, count - 1), count - 1))
    for (first, last), level in zip(spans, y[3 * count :], strict=True):
        parts.append(
            f'<path class="mean" d="M{x[first] - 2:.1f} {level:.1f}H{x[last] + 2:.1f}"/>'
        )
    label = f"{count} diagnoses, {points[0]['date']} to {points[-1]['date']}"
    # all parts are numbers and dates
    return Markup(
        f'<svg class="sparkline" role="img" aria-label="{label}" width="{WIDTH}" height="{HEIGHT}">'
        f"<title>{label}</title>{''.join(parts)}</svg>"
    )


def _scaled(numbers: Sequence[float], size: int) -> list[float]:
    """Numbers as pixels from one margin to the other; in the middle if all are the same."""
    least, most = min(numbers), max(numbers)
    if most == least:
        return [size / 2] * len(numbers)
    scale = (size - 2 * EDGE) / (most - least)
    return [EDGE + scale * (number - least) for number in numbers]
