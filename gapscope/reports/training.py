"""A training as a page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from gapscope.agents.training.task import Task
from gapscope.agents.training.training_loop import Trained
from gapscope.reports.pages import (
    PageSection,
    drawn,
    figure_html,
    write_plot_page,
)

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

ARMS = {"simulator": "simulator", "hidden": "arm with hidden effects"}
"""Arms on which an agent is tried, with their names."""
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
    rows = [
        {
            "steps": point["steps"],
            "arm": name,
            "joint error [mrad]": 1e3 * point[arm]["joint_error"],
            "reward per action": point[arm]["reward"],
        }
        for arm, name in ARMS.items()
        for point in trained.curve
        # without hidden effects there is one arm only
        if point[arm] is not None
    ]
    figure = drawn(
        "line",
        pd.DataFrame(rows).melt(["steps", "arm"], None, "panel", "score"),
        {"steps": "actions of training", "score": ""},
        color="arm",
        facet_col="panel",
        facet_col_spacing=0.08,
        markers=True,
    )
    best = trained.curve[trained.best]["steps"]
    for trace in figure.data:
        # the agent that is kept is marked
        trace.marker.size = np.where(trace.x == best, KEPT_MARKER, MARKER)
    figure.update_yaxes(matches=None, showticklabels=True)
    figure.update_yaxes(rangemode="tozero", col=1)
    return figure
