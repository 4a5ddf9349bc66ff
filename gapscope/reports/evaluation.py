"""An evaluation by tracking as a page, on the terminal and as files."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from gapscope.agents.evaluation import Evaluation, TrackingBench
from gapscope.agents.summary import Mean, SummaryLine, relation
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import write_json
from gapscope.effects.corrected_file import described
from gapscope.reports.pages import COLOURS, PageSection, figure_html, write_plot_page

if TYPE_CHECKING:
    from plotly.graph_objects import Box, Figure, Scatter

# An evaluation as a table, for the terminal and the page.


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


# An evaluation as a page of plots and a table that opens without a network.


MRAD, MM, PERCENT = 1e3, 1e3, 100.0
"""Factors from rad, m and 1 to what the figures show."""


@dataclass(frozen=True)
class RowGroup:
    """What is drawn in one colour: one engine and one disturbance.

    Attributes:
        name: in the legend.
        colour: of its marks.
        lines: of the summary, one per model.
        episodes: rows of the document.
    """

    name: str
    colour: str
    lines: Sequence[SummaryLine]
    episodes: Sequence[Mapping[str, Any]]


def write_page(
    content: Mapping[str, Any], lines: Sequence[SummaryLine], path: Path
) -> None:
    """Write tracking errors by model, the relation to the torque error, stable bandwidths, and the table.

    Args:
        content: the document.
        lines: its summary.
        path: the page.

    Raises:
        GapscopeError: the file cannot be written.
    """
    sections = (
        PageSection(figure=figure_html(_figure(content, lines), "evaluation", 820)),
        PageSection(
            note="Interquartile means over motions and seeds, with bootstrap intervals of 95 %.",
            heads=HEADS,
            rows=[cells(line) for line in lines],
        ),
    )
    title = f"Tracking of {content['arm']['robot']}"
    write_plot_page(path, title, _facts(content), sections, whole=True)


def _facts(content: Mapping[str, Any]) -> str:
    """The plan of the evaluation, the hidden effects and the rank correlation, in sentences."""
    plan = content["plan"]
    names = {effect["effect"] for effect in content["effects"]}
    effects = ", ".join(sorted(names)) or "none"
    facts = (
        f"Law {plan['law']}, {plan['bandwidth']:g} Hz, damping {plan['damping']:g}; motions "
        f"{', '.join(plan['motions'])} of {plan['duration']:g} s; disturbances {', '.join(plan['disturbances'])}; "
        f"{len(plan['seeds'])} seeds. Hidden effects: {effects}."
    )
    correlation = content["rank_correlation_of_torque_and_joint_error"]
    if correlation is not None:
        facts += (
            f" Rank correlation of torque error and joint error: {correlation:.2f}."
        )
    return facts


def _figure(content: Mapping[str, Any], lines: Sequence[SummaryLine]) -> Figure:
    """Four panels: joint error, tool error, joint error over torque error, and stable bandwidth."""
    from plotly.subplots import make_subplots

    titles = (
        "joint error [mrad]",
        "tool error [mm]",
        "joint error over torque error",
        "largest stable bandwidth [Hz]",
    )
    figure = make_subplots(rows=2, cols=2, subplot_titles=titles, vertical_spacing=0.16)
    for group in _groups(content, lines):
        # only the first trace of a group enters the legend; the others follow its switch
        figure.add_trace(_errors(group, "joint_error", MRAD, True), row=1, col=1)
        figure.add_trace(_errors(group, "tool_error", MM, False), row=1, col=2)
        figure.add_trace(_relation(group), row=2, col=1)
        figure.add_trace(_bandwidths(group), row=2, col=2)
    torque = "NRMSE of the feedforward torque [%]"
    figure.update_yaxes(type="log", row=1)
    figure.update_xaxes(title={"text": torque}, row=2, col=1)
    figure.update_yaxes(title={"text": "joint error [mrad]"}, type="log", row=2, col=1)
    figure.update_yaxes(rangemode="tozero", row=2, col=2)
    figure.update_layout(boxmode="group")
    return figure


def _groups(content: Mapping[str, Any], lines: Sequence[SummaryLine]) -> list[RowGroup]:
    """Lines and episodes by engine and disturbance, in the order of the lines."""
    groups = []
    kinds = dict.fromkeys((line.engine, line.disturbance) for line in lines)
    for number, (engine, disturbance) in enumerate(kinds):
        own = [
            line
            for line in lines
            if (line.engine, line.disturbance) == (engine, disturbance)
        ]
        episodes = [
            episode
            for episode in content["episodes"]
            if (episode["engine"], episode["disturbance"]) == (engine, disturbance)
        ]
        name = f"{engine}, disturbed: {disturbance}"
        groups.append(RowGroup(name, COLOURS[number % len(COLOURS)], own, episodes))
    return groups


def _errors(group: RowGroup, measure: str, factor: float, legend: bool) -> Box:
    """A measure of each episode, by model; episodes that diverged have none."""
    from plotly.graph_objects import Box

    shown = [episode for episode in group.episodes if episode[measure] is not None]
    return Box(
        x=[episode["model"] for episode in shown],
        y=[factor * episode[measure] for episode in shown],
        name=group.name,
        legendgroup=group.name,
        showlegend=legend,
        marker={"color": group.colour, "size": 4},
        boxpoints="all",
        jitter=0.4,
    )


def _relation(group: RowGroup) -> Scatter:
    """Mean joint error of each model over its torque error."""
    from plotly.graph_objects import Scatter

    # too many diverged episodes make a mean infinite
    ended = [line for line in group.lines if isfinite(line.means["joint_error"].value)]
    torque = [line.torque_error for line in ended]
    joint = [line.means["joint_error"] for line in ended]
    return Scatter(
        x=[PERCENT * mean.value for mean in torque],
        y=[MRAD * mean.value for mean in joint],
        error_x=_bars(torque, PERCENT),
        error_y=_bars(joint, MRAD),
        text=[line.model for line in ended],
        mode="markers+text",
        textposition="top center",
        marker={"color": group.colour, "size": 8},
        name=group.name,
        legendgroup=group.name,
        showlegend=False,
    )


def _bandwidths(group: RowGroup) -> Scatter:
    """Largest stable bandwidth of each model."""
    from plotly.graph_objects import Scatter

    return Scatter(
        x=[line.model for line in group.lines],
        y=[line.margin for line in group.lines],
        mode="markers",
        name=group.name,
        marker={"color": group.colour, "size": 10},
        legendgroup=group.name,
        showlegend=False,
    )


def _bars(means: Sequence[Mean], factor: float) -> dict[str, Any]:
    """Error bars of means; an interval without an upper end has no bar above."""
    above = [factor * (m.high - m.value) if isfinite(m.high) else 0.0 for m in means]
    below = [factor * (m.value - m.low) for m in means]
    return {
        "type": "data",
        "symmetric": False,
        "array": above,
        "arrayminus": below,
        "thickness": 1,
    }


# An evaluation as files: page, episodes as CSV, and ``evaluation.json``.


DOCUMENT, PAGE, TABLE = "evaluation.json", "evaluation.html", "evaluation.csv"


def write_evaluation(
    content: Mapping[str, Any], lines: Sequence[SummaryLine], folder: Path
) -> list[Path]:
    """Write the page, the episodes as CSV and, as the last, ``evaluation.json``.

    Args:
        content: what ``evaluation_document`` made.
        lines: the summary, a line per disturbance, engine and model.
        folder: of the results.

    Raises:
        GapscopeError: a file cannot be written.
    """
    write_page(content, lines, folder / PAGE)
    _write_table(content["episodes"], folder / TABLE)
    write_json(content, folder / DOCUMENT)
    return [folder / name for name in (PAGE, DOCUMENT, TABLE)]


def _write_table(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    with (
        atomic_write(path) as aside,
        aside.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def evaluation_document(
    bench: TrackingBench, evaluation: Evaluation, lines: list[SummaryLine]
) -> dict[str, Any]:
    """An evaluation as plain data; numbers that are not finite are ``None``."""
    plan = bench.plan
    return {
        "schema": 1,
        "arm": {"robot": bench.arm.name, "joints": list(bench.arm.joints)},
        "effects": [described(applied) for applied in bench.effects],
        "plan": {
            "motions": list(plan.motions),
            "disturbances": list(plan.disturbances),
            "seeds": list(plan.seeds),
            "engines": list(plan.engines),
            "duration": plan.duration,
            "law": plan.law,
            "bandwidth": plan.tuning.bandwidth,
            "damping": plan.tuning.damping,
        },
        "models": [line.plain() for line in lines],
        "rank_correlation_of_torque_and_joint_error": relation(lines),
        "episodes": [episode.row() for episode in evaluation.episodes],
    }
