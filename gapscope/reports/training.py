"""A training as a page."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from gapscope.agents.training.task import Task
from gapscope.agents.training.training_loop import Trained
from gapscope.reports.pages import (
    COLOURS,
    PageSection,
    figure_html,
    subplots,
    write_plot_page,
)

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

ARMS = {"simulator": "simulator", "hidden": "arm with hidden effects"}
"""Arms on which an agent is tried, with their names."""
MEASURES = {"joint_error": 1e3, "reward": 1.0}
"""Measures, with the factor to the unit of the panel."""
MARKER, KEPT_MARKER = 6, 13
"""Sizes of a point, and of the agent that is kept [pixels]."""


def write_page(task: Task, trained: Trained, path: Path) -> None:
    """Write joint error and reward over steps, in the simulator and on the hidden arm.

    Args:
        task: what was trained and tried on.
        trained: what came out.
        path: the page.

    Raises:
        GapscopeError: the file cannot be written.
    """
    figure = figure_html(_figure(trained), "training", 460)
    # what was trained, and which agent is kept and why, in sentences
    settings, drawn = trained.settings, ""
    if settings.randomise:
        drawn = f", drawn around it: {', '.join(settings.randomise)}"
    elif task.ranges is not None:
        drawn = ", drawn around it: what its diagnosis leaves open"
    reason = trained.reason
    facts = (
        f"{settings.algorithm.upper()} on top of {task.name}{drawn}; action {settings.action}, seed {settings.seed}. "
        f"{reason[0].upper()}{reason[1:]}. The last agent is in last/."
    )
    if trained.stopped:
        facts += " Training ended early, for want of improvement."
    write_plot_page(
        path,
        f"Training on {task.arm.name}",
        facts,
        [PageSection(figure=figure)],
    )


def _figure(trained: Trained) -> Figure:
    """Joint error and reward over steps, each on both arms; gaps if an arm was not tracked to the end."""
    figure = subplots(1, 2, subplot_titles=("joint error [mrad]", "reward per action"))
    best = trained.curve[trained.best]["steps"]
    for (arm, name), colour in zip(ARMS.items(), COLOURS, strict=False):
        # without hidden effects there is one arm only
        points = [point for point in trained.curve if point[arm] is not None]
        # the agent that is kept is marked
        sizes = [KEPT_MARKER if point["steps"] == best else MARKER for point in points]
        for column, (measure, factor) in enumerate(MEASURES.items(), 1):
            scores = [point[arm][measure] for point in points]
            figure.add_scatter(
                x=[point["steps"] for point in points],
                # where the arm diverged the line has a gap
                y=[factor * score if isfinite(score) else None for score in scores],
                mode="lines+markers",
                marker={"size": sizes, "color": colour},
                name=name,
                line={"color": colour},
                legendgroup=name,
                showlegend=column == 1,
                row=1,
                col=column,
            )
    figure.update_xaxes(title={"text": "actions of training"})
    figure.update_yaxes(rangemode="tozero", col=1)
    return figure
