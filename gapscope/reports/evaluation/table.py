"""An evaluation as a table, for the terminal and the page."""

from __future__ import annotations

from typing import Any

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from gapscope.agents.summary import Mean, SummaryLine

HEADS = (
    "model",
    "engine",
    "disturbed",
    "joints [mrad]",
    "tool [mm]",
    "reward",
    "torque rate [N m/s]",
    "torque NRMSE [%]",
    "diverged",
    "stable to [Hz]",
)
"""Headings of the columns."""


MEANS = (
    ("joint_error", 1e3),
    ("tool_error", 1e3),
    ("reward", 1.0),
    ("torque_rate", 1.0),
    ("torque_error", 100.0),
)
"""Measures and their factors, in the order of the columns."""


def tables(lines: list[SummaryLine], content: dict[str, Any]) -> Group:
    """What the terminal shows, within 80 columns: a table for each engine and disturbance."""
    plan = content["plan"]
    heading = (
        f"{content['arm']['robot']}, {plan['law']}, {plan['bandwidth']:g} Hz: "
        "interquartile means, and 95 % intervals"
    )
    kinds = dict.fromkeys((line.engine, line.disturbance) for line in lines)
    return Group(
        Text(heading),
        *(
            _table(
                [line for line in lines if (line.engine, line.disturbance) == kind],
                kind,
            )
            for kind in kinds
        ),
    )


def _table(lines: list[SummaryLine], kind: tuple[str, str]) -> Table:
    title = f"\n{kind[0]}, disturbance: {kind[1]}"
    shown = Table(
        title=title,
        title_justify="left",
        padding=(0, 1, 0, 0),
        box=box.SIMPLE_HEAD,
        show_edge=False,
    )
    shown.add_column("model", overflow="fold")
    for heading in HEADS[3:]:
        name, bracket, unit = heading.partition(" [")
        head = name.replace(" ", "\n").replace("diverged", "di-\nverged") + (
            f"\n[{unit}" if bracket else ""
        )
        shown.add_column(Text(head), justify="right", no_wrap=True)
    for line in lines:
        means = [_two_lines(mean(line, name), factor) for name, factor in MEANS]
        shown.add_row(*(Text(cell) for cell in (line.model, *means, *cells(line)[-2:])))
    return shown


def cells(line: SummaryLine) -> list[str]:
    """A line as texts, one per heading."""
    return [
        line.model,
        line.engine,
        line.disturbance,
        *(_one_line(mean(line, name), factor) for name, factor in MEANS),
        f"{line.diverged}/{line.count}",
        "–" if line.margin is None else f"{line.margin:.1f}",
    ]


def mean(line: SummaryLine, name: str) -> Mean:
    """A mean of a line by the name of its measure."""
    return line.torque_error if name == "torque_error" else line.means[name]


def _one_line(mean: Mean, factor: float) -> str:
    value, low, high = (_digits(factor * x, 3) for x in mean)
    return f"{value} [{low}, {high}]"


def _two_lines(mean: Mean, factor: float) -> str:
    low, high = (_digits(factor * x, 2) for x in mean[1:])
    return f"{_digits(factor * mean.value, 3)}\n{low}–{high}"


def _digits(value: float, digits: int) -> str:
    """So many digits, without an exponent below a million; ``inf`` if too many episodes diverged."""
    return f"{value:.0f}" if 10**digits <= abs(value) < 1e6 else f"{value:.{digits}g}"
