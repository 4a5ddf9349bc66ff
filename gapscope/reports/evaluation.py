"""An evaluation by tracking as a page, on the terminal and as files."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
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
    PLAIN,
    PageSection,
    drawn,
    figure_html,
    terminal_table,
    with_bars,
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
    shown = []
    for kind in dict.fromkeys(map(_kind, lines)):
        own = [line for line in lines if _kind(line) == kind]
        shown.append(_table(own, f"\n{kind}"))
    return Group(Text(heading), *shown)


def _kind(of: Mapping[str, Any]) -> str:
    """Engine and disturbance of an episode or a line, in words."""
    return f"{of['engine']}, disturbed: {of['disturbance']}"


def _table(lines: list[Line], title: str) -> Table:
    heads = ["model"]
    for heading in HEADS[3:]:
        name, bracket, unit = heading.partition(" [")
        # heads over two lines keep the table within 80 columns
        name = name.replace(" ", "\n").replace("diverged", "di-\nverged")
        heads.append(f"{name}\n[{unit}" if bracket else name)
    rows = [
        [Text(line["model"], overflow="fold"), *map(Text, cells(line, 2)[3:])]
        for line in lines
    ]
    return terminal_table(heads, rows, 1, slice(1, None), title=title, **PLAIN)


def cells(line: Line, digits: int = 3) -> list[str]:
    """A line as texts, one per heading, with so many digits of the ends of intervals."""
    return [
        line["model"],
        line["engine"],
        line["disturbance"],
        *(_mean(line[name], factor, digits) for name, factor in MEANS),
        f"{line['diverged']['count']}/{line['episodes']}",
        "–" if line["margin"] is None else f"{line['margin']:.1f}",
    ]


def _mean(mean: Mapping[str, float], factor: float, digits: int) -> str:
    """A mean, and its interval on the next line."""
    low, high = (_digits(factor * mean[key], digits) for key in ("low", "high"))
    return f"{_digits(factor * mean['value'], 3)}\n{low}–{high}"


def _digits(value: float, digits: int) -> str:
    """So many digits, without an exponent below a million; ``inf`` if too many episodes diverged."""
    return f"{value:.0f}" if 10**digits <= abs(value) < 1e6 else f"{value:.{digits}g}"


# An evaluation as a page of plots and a table that opens without a network.


MILLI, PERCENT = 1e3, 100.0
"""Factors from rad, m and 1 to what the figures show."""
ERRORS = {"joint_error": "joint error [mrad]", "tool_error": "tool error [mm]"}
"""Errors of an episode, as their panels are called."""


def write_page(content: Document, lines: Sequence[Line], path: Path) -> None:
    """Write tracking errors by model, the relation to the torque error, stable bandwidths, and the table.

    Args:
        content: the document.
        lines: its summary.
        path: the page.

    Raises:
        GapscopeError: the file cannot be written.
    """
    figures = _figures(content, lines).items()
    sections = (
        *(PageSection(figure=figure_html(x, name, 420)) for name, x in figures),
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


def _figures(content: Document, lines: Sequence[Line]) -> dict[str, Figure]:
    """Joint and tool errors of all episodes, joint error over torque error, and stable bandwidths.

    An engine and a disturbance have one colour in all of them.
    """
    episodes = pd.DataFrame(content["episodes"]).rename(columns=ERRORS)
    episodes["kind"] = [_kind(episode) for episode in content["episodes"]]
    panels = list(ERRORS.values())
    errors = episodes.melt(["model", "kind"], panels, "panel", "error")
    boxes = drawn(
        "box",
        # episodes that diverged have none
        errors.assign(error=MILLI * errors["error"].astype(float)),
        {"model": "", "error": ""},
        color="kind",
        facet_col="panel",
        facet_col_spacing=0.06,
        points="all",
        # good and bad models differ by decades
        log_y=True,
    )
    boxes.update_yaxes(matches=None, showticklabels=True)
    models = pd.DataFrame(
        {"model": line["model"], "kind": _kind(line), "margin": line["margin"]}
        for line in lines
    )
    # too many diverged episodes make a mean infinite, which is not drawn
    for name, factor in (("joint_error", MILLI), ("torque_error", PERCENT)):
        bars = with_bars([line[name] for line in lines], factor)
        models = models.join(bars.add_prefix(f"{name}_"))
    relation = drawn(
        "scatter",
        models,
        {
            "torque_error_value": "NRMSE of the feedforward torque [%]",
            "joint_error_value": ERRORS["joint_error"],
        },
        error_x="torque_error_above",
        error_x_minus="torque_error_below",
        error_y="joint_error_above",
        error_y_minus="joint_error_below",
        color="kind",
        text="model",
        log_y=True,
    )
    relation.update_traces(textposition="top center", marker_size=8)
    margins = drawn(
        "scatter",
        models,
        {"model": "", "margin": "largest stable bandwidth [Hz]"},
        color="kind",
    )
    margins.update_traces(marker_size=10)
    margins.update_yaxes(rangemode="tozero")
    return {"errors": boxes, "relation": relation, "bandwidths": margins}


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
