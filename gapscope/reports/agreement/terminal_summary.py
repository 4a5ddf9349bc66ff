"""An agreement on the terminal: one line per parameter, and what is to be said of those that differ."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from gapscope.reports.agreement.lines import (
    RELATIVE,
    differing,
    heading,
    sentences,
    trusted,
    undetermined,
    values,
    with_unit,
)

STYLES = {"differs": "bold red", "not determined": "dim"}
"""Style of a verdict."""


def summary(content: dict[str, Any]) -> Group:
    """The table of all parameters, then the differences with what goes with them."""
    table = Table(
        title=f"{content['case']}: {heading(content)}",
        title_justify="left",
        caption=RELATIVE,
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        show_edge=False,
        padding=(0, 1, 0, 0),
    )
    table.add_column("parameter", overflow="fold")
    table.add_column("verdict", no_wrap=True)
    table.add_column("to trust", justify="right", no_wrap=True)
    for line in content["parameters"]:
        verdict = Text(line["verdict"], STYLES.get(line["verdict"], ""))
        value = with_unit(trusted(line), line)
        table.add_row(Text(line["name"]), verdict, value)
    texts = [*_undetermined(content), *_differences(content)]
    return Group(table, *(Text(text) for text in texts))


def _undetermined(content: dict[str, Any]) -> Iterator[str]:
    """A line for each recording that does not determine some parameters."""
    missing: dict[str, list[str]] = {}
    for line in content["parameters"]:
        for recording in undetermined(line, content["recordings"]):
            missing.setdefault(recording, []).append(line["name"])
    for recording, names in missing.items():
        yield f"\n{recording} does not determine: {'; '.join(names)}"


def _differences(content: dict[str, Any]) -> Iterator[str]:
    """Lines on each parameter that differs."""
    for line in differing(content):
        pairs = zip(content["recordings"], values(line), strict=True)
        by_recording = [f"{name} {with_unit(value, line)}" for name, value in pairs]
        yield f"\n{line['name']} differs: {', '.join(by_recording)}"
        yield from (f"  {text}" for text in sentences(line))
