"""An audit on the terminal: one paragraph per kind of finding, worst first."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rich.console import Group
from rich.text import Text

from gapscope.reports.model_audit.lines import groups, heading, number, place

STYLES = {"impossible": "bold red", "implausible": "red", "missing": "yellow"}
"""Style of a severity."""
MOST_EXPLANATIONS = 4


def summary(content: dict[str, Any]) -> Group:
    """What is odd about a model, and what to do."""
    head = Text(f"{content['robot']} ({content['file']}): {heading(content)}", "bold")
    parts = [head]
    for group in groups(content):
        worst = group.worst
        title = Text(
            f"\n{worst['severity']}: {worst['kind'].replace('_', ' ')}, {place(worst)}",
            STYLES.get(worst["severity"], ""),
        )
        parts += [title, Text(f"  {worst['found']}")]
        parts += [Text(f"  expected: {worst['expected']}")]
        parts += [Text(f"  to do: {worst['remedy']}")]
        if group.others:
            parts.append(Text(f"  also: {group.others}"))
    if content["static"] is not None:
        parts += [Text(line) for line in _static(content["static"])]
    return Group(*parts)


def _static(static: dict[str, Any]) -> Iterator[str]:
    """Gravity torque against measured, joint by joint."""
    yield f"\ngravity torque in {static['poses']} poses, measured against the model's:"
    columns = (static[name] for name in ("joints", "correlation", "scale", "offset"))
    for joint, correlation, scale, offset in zip(*columns, strict=True):
        yield (
            f"  {joint}: correlation {number(correlation)}, scale {number(scale)}, "
            f"offset {number(offset)} N m"
        )
    for one in static["explanations"][:MOST_EXPLANATIONS]:
        yield f"  {one['name']} leaves {one['misfit']:.1%} of the spread"
