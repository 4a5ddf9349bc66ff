"""A learning curve as a page that opens without a network."""

from __future__ import annotations

from html import escape
from math import isfinite
from pathlib import Path

from gapscope.agents.training.task import Task
from gapscope.agents.training.training_loop import Trained
from gapscope.agents.training.training_settings import TrainingSettings
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.reports.trajectory.page import COLOURS, FONT, GROUND, INK, LINE


def write_page(
    task: Task, settings: TrainingSettings, trained: Trained, path: Path
) -> None:
    """Write joint error and reward over steps, in the simulator and on the hidden arm.

    Args:
        task: what was trained and tried on.
        settings: of the training.
        trained: what came out.
        path: the page.

    Raises:
        GapscopeError: the file cannot be written.
    """
    best = trained.curve[trained.best]
    kept = (
        "the untrained agent"
        if trained.best == 0
        else f"the agent after {best.steps} steps"
    )
    early = " Training ended early, for want of improvement." if trained.stopped else ""
    drawn = (
        f", randomised: {', '.join(settings.randomise)}" if settings.randomise else ""
    )
    facts = (
        f"{settings.algorithm.upper()} on top of {task.name}{drawn}; action {settings.action}, seed {settings.seed}. "
        f"Kept is {kept}, the best in the simulator made from the model.{early}"
    )
    page = _PAGE.format(
        font=FONT,
        ink=INK,
        line=LINE,
        ground=GROUND,
        title=escape(f"Training on {task.arm.name}"),
        facts=escape(facts),
        figure=_figure(trained),
    )
    with atomic_write(path) as aside:
        aside.write_text(page, encoding="utf-8")


def _figure(trained: Trained) -> str:
    """Two panels, with plotly's code, as HTML."""
    from plotly.graph_objects import Scatter
    from plotly.subplots import make_subplots

    figure = make_subplots(
        rows=1, cols=2, subplot_titles=("joint error [mrad]", "reward per action")
    )
    best = trained.curve[trained.best]
    for number, (part, name) in enumerate(
        (("simulator", "simulator"), ("hidden", "arm with hidden effects"))
    ):
        points = [
            (point.steps, getattr(point, part))
            for point in trained.curve
            if getattr(point, part) is not None
        ]
        for column, (measure, factor) in enumerate(
            (("joint_error", 1e3), ("reward", 1.0)), 1
        ):
            values = [factor * getattr(score, measure) for _, score in points]
            sizes = [13 if steps == best.steps else 6 for steps, _ in points]
            figure.add_trace(
                Scatter(
                    x=[steps for steps, _ in points],
                    y=[v if isfinite(v) else None for v in values],
                    mode="lines+markers",
                    marker={"size": sizes, "color": COLOURS[number]},
                    name=name,
                    line={"color": COLOURS[number]},
                    legendgroup=name,
                    showlegend=column == 1,
                ),
                row=1,
                col=column,
            )
    figure.update_xaxes(title={"text": "actions of training"}, gridcolor=LINE)
    figure.update_yaxes(gridcolor=LINE)
    figure.update_yaxes(rangemode="tozero", col=1)
    figure.update_layout(
        height=460,
        font={"family": FONT, "size": 13, "color": INK},
        paper_bgcolor="#fff",
        plot_bgcolor="#fff",
        margin={"l": 62, "r": 14, "t": 64, "b": 46},
        legend={"orientation": "h", "x": 0, "y": 1.1, "yanchor": "bottom"},
    )
    # Buttons named one by one: by default there is one that sends the data to a server.
    buttons = [["zoom2d", "pan2d", "resetScale2d", "toImage"]]
    config = {
        "responsive": True,
        "displaylogo": False,
        "plotlyServerURL": "",
        "modeBarButtons": buttons,
    }
    return str(
        figure.to_html(
            full_html=False, include_plotlyjs=True, config=config, div_id="training"
        )
    )


_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>
body {{ margin: 0 auto; padding: 20px 28px 48px; max-width: 1200px; color: {ink}; background: {ground};
  font: 15px/1.5 {font}; }}
h1 {{ font-size: 23px; font-weight: 600; margin: 6px 0 8px; }}
section {{ background: #fff; border: 1px solid {line}; border-radius: 10px; padding: 16px 18px; margin-top: 16px; }}
</style></head><body><h1>{title}</h1><p>{facts}</p><section>{figure}</section></body></html>
"""
