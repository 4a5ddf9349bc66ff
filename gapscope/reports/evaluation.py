"""An evaluation by tracking as a page, on the terminal and as files."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from gapscope.agents.evaluation import (
    Episode,
    Line,
    TrackingBench,
    relation,
)
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import plain, write_json
from gapscope.diagnosis.document.wording import Document
from gapscope.effects.corrected_file import described
from gapscope.reports.pages import (
    COLOURS,
    PLAIN,
    PageSection,
    error_bars,
    figure_html,
    subplots,
    terminal_table,
    write_plot_page,
)

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

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


def tables(lines: list[Line], content: Document) -> Group:
    """What the terminal shows, within 80 columns: a table for each engine and disturbance."""
    plan = content["plan"]
    heading = (
        f"{content['arm']['robot']}, {plan['law']}, {plan['bandwidth']:g} Hz: "
        "interquartile means, and 95 % intervals"
    )
    # models compare only in one engine and under one disturbance
    by_kind = _by_kind(lines)
    return Group(Text(heading), *(_table(own, kind) for kind, own in by_kind.items()))


def _by_kind(
    lines: Sequence[Line],
) -> dict[tuple[str, str], list[Line]]:
    """Lines by engine and disturbance, in their order."""
    found: dict[tuple[str, str], list[Line]] = {}
    for line in lines:
        found.setdefault((line["engine"], line["disturbance"]), []).append(line)
    return found


def _table(lines: list[Line], kind: tuple[str, str]) -> Table:
    heads = ["model"]
    for heading in HEADS[3:]:
        name, bracket, unit = heading.partition(" [")
        # heads over two lines keep the table within 80 columns
        name = name.replace(" ", "\n").replace("diverged", "di-\nverged")
        heads.append(f"{name}\n[{unit}" if bracket else name)
    rows = []
    for line in lines:
        means = [_two_lines(line[name], factor) for name, factor in MEANS]
        model = Text(line["model"], overflow="fold")
        # the last two cells are no means
        rows.append([model, *map(Text, (*means, *cells(line)[-2:]))])
    title = f"\n{kind[0]}, disturbance: {kind[1]}"
    return terminal_table(heads, rows, 1, slice(1, None), title=title, **PLAIN)


def cells(line: Line) -> list[str]:
    """A line as texts, one per heading."""
    return [
        line["model"],
        line["engine"],
        line["disturbance"],
        *(_one_line(line[name], factor) for name, factor in MEANS),
        f"{line['diverged']['count']}/{line['episodes']}",
        "–" if line["margin"] is None else f"{line['margin']:.1f}",
    ]


def _one_line(mean: Mapping[str, float], factor: float) -> str:
    value, low, high = (_digits(factor * x, 3) for x in mean.values())
    return f"{value} [{low}, {high}]"


def _two_lines(mean: Mapping[str, float], factor: float) -> str:
    low, high = (_digits(factor * x, 2) for x in (mean["low"], mean["high"]))
    return f"{_digits(factor * mean['value'], 3)}\n{low}–{high}"


def _digits(value: float, digits: int) -> str:
    """So many digits, without an exponent below a million; ``inf`` if too many episodes diverged."""
    return f"{value:.0f}" if 10**digits <= abs(value) < 1e6 else f"{value:.{digits}g}"


# An evaluation as a page of plots and a table that opens without a network.


MILLI, PERCENT = 1e3, 100.0
"""Factors from rad, m and 1 to what the figures show."""


def write_page(content: Document, lines: Sequence[Line], path: Path) -> None:
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
            numbers=True,
        ),
    )
    title = f"Tracking of {content['arm']['robot']}"
    # the plan of the evaluation, the hidden effects and the rank correlation, in sentences
    plan = content["plan"]
    # each once, on however many joints
    names = {effect["effect"] for effect in content["effects"]}
    effects = ", ".join(sorted(names)) or "none"
    facts = (
        f"Law {plan['law']}, {plan['bandwidth']:g} Hz, damping {plan['damping']:g}; motions "
        f"{', '.join(plan['motions'])} of {plan['duration']:g} s; disturbances {', '.join(plan['disturbances'])}; "
        f"{len(plan['seeds'])} seeds. Hidden effects: {effects}."
    )
    # too few models have none
    correlation = content["rank_correlation_of_torque_and_joint_error"]
    if correlation is not None:
        facts += (
            f" Rank correlation of torque error and joint error: {correlation:.2f}."
        )
    # the script of lines and bars draws no boxes
    write_plot_page(path, title, facts, sections, whole=True)


def _figure(content: Document, lines: Sequence[Line]) -> Figure:
    """Four panels: joint error, tool error, joint error over torque error, and stable bandwidth.

    An engine and a disturbance have one colour; the first trace of theirs enters the legend, the others follow it.
    """
    titles = (
        "joint error [mrad]",
        "tool error [mm]",
        "joint error over torque error",
        "largest stable bandwidth [Hz]",
    )
    figure = subplots(2, 2, subplot_titles=titles, vertical_spacing=0.16)
    # a colour for each engine and disturbance, in all four panels
    for number, (kind, own) in enumerate(_by_kind(lines).items()):
        colour = COLOURS[number % len(COLOURS)]
        name = f"{kind[0]}, disturbed: {kind[1]}"
        common = {"name": name, "legendgroup": name}
        episodes = [
            episode
            for episode in content["episodes"]
            if (episode["engine"], episode["disturbance"]) == kind
        ]
        for column, measure in enumerate(("joint_error", "tool_error"), 1):
            # episodes that diverged have none
            ended = [e for e in episodes if e[measure] is not None]
            figure.add_box(
                x=[episode["model"] for episode in ended],
                y=[MILLI * episode[measure] for episode in ended],
                showlegend=column == 1,
                marker={"color": colour, "size": 4},
                boxpoints="all",
                jitter=0.4,
                row=1,
                col=column,
                **common,
            )
        # too many diverged episodes make a mean infinite
        shown = [line for line in own if isfinite(line["joint_error"]["value"])]
        torque = [line["torque_error"] for line in shown]
        joint = [line["joint_error"] for line in shown]
        figure.add_scatter(
            x=[PERCENT * mean["value"] for mean in torque],
            y=[MILLI * mean["value"] for mean in joint],
            error_x=_bars(torque, PERCENT),
            error_y=_bars(joint, MILLI),
            text=[line["model"] for line in shown],
            mode="markers+text",
            textposition="top center",
            marker={"color": colour, "size": 8},
            showlegend=False,
            row=2,
            col=1,
            **common,
        )
        figure.add_scatter(
            x=[line["model"] for line in own],
            y=[line["margin"] for line in own],
            mode="markers",
            marker={"color": colour, "size": 10},
            showlegend=False,
            row=2,
            col=2,
            **common,
        )
    torque_title = "NRMSE of the feedforward torque [%]"
    # good and bad models differ by decades
    figure.update_yaxes(type="log", row=1)
    figure.update_xaxes(title={"text": torque_title}, row=2, col=1)
    figure.update_yaxes(title={"text": "joint error [mrad]"}, type="log", row=2, col=1)
    figure.update_yaxes(rangemode="tozero", row=2, col=2)
    figure.update_layout(boxmode="group")
    return figure


def _bars(means: Sequence[Mapping[str, float]], factor: float) -> Document:
    """Error bars of means."""
    series = [[mean[key] for mean in means] for key in ("value", "low", "high")]
    return error_bars(*(factor * np.array(series)), thickness=1)


# An evaluation as files: page, episodes as CSV, and ``evaluation.json``.


DOCUMENT, PAGE, TABLE = "evaluation.json", "evaluation.html", "evaluation.csv"


def write_evaluation(
    content: Document, lines: Sequence[Line], folder: Path
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
    rows = content["episodes"]
    with (
        atomic_write(folder / TABLE) as aside,
        aside.open("w", newline="", encoding="utf-8") as file,
    ):
        # all episodes have the same measures
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    write_json(content, folder / DOCUMENT)
    return [folder / name for name in (PAGE, DOCUMENT, TABLE)]


def evaluation_document(
    bench: TrackingBench, episodes: Sequence[Episode], lines: list[Line]
) -> Document:
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
        "models": plain(lines, null_if_not_finite=True),
        "rank_correlation_of_torque_and_joint_error": relation(lines),
        "episodes": plain(episodes, null_if_not_finite=True),
    }
