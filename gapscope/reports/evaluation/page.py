"""An evaluation as a page of plots and a table that opens without a network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gapscope.agents.summary import Mean, SummaryLine
from gapscope.reports.evaluation.table import HEADS, cells
from gapscope.reports.plot_page import (
    COLOURS,
    PageSection,
    figure_html,
    write_plot_page,
)

if TYPE_CHECKING:
    from plotly.graph_objects import Box, Figure, Scatter

MRAD, MM, PERCENT = 1e3, 1e3, 100.0
"""Factors from rad, m and 1 to what the figures show."""


@dataclass(frozen=True)
class Group:
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


def _groups(content: Mapping[str, Any], lines: Sequence[SummaryLine]) -> list[Group]:
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
        groups.append(Group(name, COLOURS[number % len(COLOURS)], own, episodes))
    return groups


def _errors(group: Group, measure: str, factor: float, legend: bool) -> Box:
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


def _relation(group: Group) -> Scatter:
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


def _bandwidths(group: Group) -> Scatter:
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
