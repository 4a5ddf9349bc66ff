"""A learnt residual network as a page that opens without a network."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gapscope.arm.display import percent
from gapscope.reports.plot_page import (
    COLOURS,
    PageSection,
    figure_html,
    write_plot_page,
)
from gapscope.reports.residual.wording import facts, joint_sentence, physics_sentence

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

PANELS = {
    "position": "position [rad]",
    "velocity": "velocity [rad/s]",
    "load": "load [N m]",
}
STYLE = {
    "forward": ("forward", COLOURS[0]),
    "backward": ("backward", COLOURS[1]),
    "both": ("both directions", COLOURS[2]),
}
HEIGHT = 300
"""Height of a joint's figure [pixels]."""
HEADS = (
    "joint",
    "corrected arm [N m]",
    "with network [N m]",
    "with boosted trees [N m]",
    "closed",
    "form",
)


def write_page(content: Mapping[str, Any], path: Path) -> None:
    """Write the page of a document of the form of ``residual.schema.json``.

    Raises:
        GapscopeError: the file cannot be written.
    """
    table = PageSection(
        title="Torque left on the recordings set aside",
        note="RMS below 12 Hz, on motions that neither the network nor the trees were trained on.",
        heads=HEADS,
        rows=[_row(k, joint) for k, joint in enumerate(content["joints"], 1)],
    )
    physics = PageSection(
        title="Apart from the physics", note=physics_sentence(content)
    )
    joints = [_section(k, joint) for k, joint in enumerate(content["joints"], 1)]
    title = f"Residual network of {content['case']}"
    write_plot_page(path, title, facts(content), [table, physics, *joints])


def _row(number: int, joint: Mapping[str, Any]) -> list[str]:
    left = joint["rmse"]
    squares = (left["network"] / left["nothing"]) ** 2 if left["nothing"] else 1.0
    values = [f"{left[key]:.3g}" for key in ("nothing", "network", "trees")]
    return [
        f"J{number} {joint['name']}",
        *values,
        percent(1 - squares),
        joint["form"] or "silent",
    ]


def _section(number: int, joint: Mapping[str, Any]) -> PageSection:
    """What a joint's network says, over its signals."""
    figure = figure_html(
        _figure(joint),
        f"joint{number}",
        HEIGHT,
        margin={"l": 62, "r": 14, "t": 40, "b": 46},
        legend={
            "orientation": "h",
            "x": 0,
            "y": 1.02,
            "yanchor": "bottom",
            "xanchor": "left",
        },
    )
    title = f"Joint {number}, {joint['name']}"
    return PageSection(title=title, note=joint_sentence(joint), figure=figure)


def _figure(joint: Mapping[str, Any]) -> Figure:
    """Three panels: dots for what the corrected arm leaves, lines for what the network says."""
    from plotly.graph_objects import Scatter
    from plotly.subplots import make_subplots

    figure = make_subplots(rows=1, cols=len(PANELS), shared_yaxes=True)
    named: set[str] = set()
    for curve in joint["curves"]:
        column = list(PANELS).index(curve["over"]) + 1
        label, colour = STYLE[curve["direction"]]
        dots = {"color": colour, "size": 6, "opacity": 0.55}
        for key, mode, name in (
            ("residual", "markers", f"left by the effects, {label}"),
            ("network", "lines", f"network, {label}"),
        ):
            drawn = Scatter(
                x=curve["x"],
                y=curve[key],
                mode=mode,
                name=name,
                legendgroup=name,
                showlegend=name not in named,
                marker=dots,
                line={"color": colour, "width": 2},
            )
            named.add(name)
            figure.add_trace(drawn, row=1, col=column)
    for column, title in enumerate(PANELS.values(), 1):
        figure.update_xaxes(title={"text": title, "standoff": 6}, row=1, col=column)
    figure.update_yaxes(title={"text": "torque [N m]", "standoff": 8}, row=1, col=1)
    return figure
