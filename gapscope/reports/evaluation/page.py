"""An evaluation as a page of plots and a table that opens without a network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from math import isfinite
from pathlib import Path
from typing import Any

from gapscope.agents.statistics import Mean
from gapscope.agents.summary import SummaryLine
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.reports.evaluation.table import HEADS, cells
from gapscope.reports.trajectory.page import COLOURS, FONT, GROUND, INK, LINE, SOFT


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
    plan = content["plan"]
    effects = ", ".join(sorted({e["effect"] for e in content["effects"]})) or "none"
    correlation = content["rank_correlation_of_torque_and_joint_error"]
    said = (
        ""
        if correlation is None
        else f" Rank correlation of torque error and joint error: {correlation:.2f}."
    )
    rows = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells(line)) + "</tr>"
        for line in lines
    )
    page = _PAGE.format(
        font=FONT,
        ink=INK,
        soft=SOFT,
        line=LINE,
        ground=GROUND,
        title=escape(f"Tracking of {content['arm']['robot']}"),
        facts=escape(
            f"Law {plan['law']}, {plan['bandwidth']:g} Hz, damping {plan['damping']:g}; motions "
            f"{', '.join(plan['motions'])} of {plan['duration']:g} s; disturbances {', '.join(plan['disturbances'])}; "
            f"{len(plan['seeds'])} seeds. Hidden effects: {effects}.{said}"
        ),
        figure=_figure(content, lines),
        rows=rows,
        heads="".join(f"<th>{escape(head)}</th>" for head in HEADS),
    )
    with atomic_write(path) as aside:
        aside.write_text(page, encoding="utf-8")


def _figure(content: Mapping[str, Any], lines: Sequence[SummaryLine]) -> str:
    """Four panels, with plotly's code, as HTML."""
    from plotly.graph_objects import Box, Scatter
    from plotly.subplots import make_subplots

    titles = (
        "joint error [mrad]",
        "tool error [mm]",
        "joint error over torque error",
        "largest stable bandwidth [Hz]",
    )
    figure = make_subplots(rows=2, cols=2, subplot_titles=titles, vertical_spacing=0.16)
    kinds = list(dict.fromkeys((line.engine, line.disturbance) for line in lines))
    for number, kind in enumerate(kinds):
        name, colour = (
            f"{kind[0]}, disturbed: {kind[1]}",
            COLOURS[number % len(COLOURS)],
        )
        episodes = [
            e for e in content["episodes"] if (e["engine"], e["disturbance"]) == kind
        ]
        own = [line for line in lines if (line.engine, line.disturbance) == kind]
        for column, measure in enumerate(("joint_error", "tool_error"), 1):
            shown = [e for e in episodes if e[measure] is not None]
            figure.add_trace(
                Box(
                    x=[e["model"] for e in shown],
                    y=[1e3 * e[measure] for e in shown],
                    name=name,
                    legendgroup=name,
                    showlegend=column == 1,
                    marker={"color": colour, "size": 4},
                    boxpoints="all",
                    jitter=0.4,
                ),
                row=1,
                col=column,
            )
        ended = [line for line in own if isfinite(line.means["joint_error"].value)]
        figure.add_trace(
            Scatter(
                x=[100 * line.torque_error.value for line in ended],
                y=[1e3 * line.means["joint_error"].value for line in ended],
                error_x=_bars([line.torque_error for line in ended], 100.0),
                error_y=_bars([line.means["joint_error"] for line in ended], 1e3),
                text=[line.model for line in ended],
                mode="markers+text",
                textposition="top center",
                marker={"color": colour, "size": 8},
                name=name,
                legendgroup=name,
                showlegend=False,
            ),
            row=2,
            col=1,
        )
        figure.add_trace(
            Scatter(
                x=[line.model for line in own],
                y=[line.margin for line in own],
                mode="markers",
                name=name,
                marker={"color": colour, "size": 10},
                legendgroup=name,
                showlegend=False,
            ),
            row=2,
            col=2,
        )
    figure.update_yaxes(type="log", row=1)
    figure.update_xaxes(
        title={"text": "NRMSE of the feedforward torque [%]"}, row=2, col=1
    )
    figure.update_yaxes(title={"text": "joint error [mrad]"}, type="log", row=2, col=1)
    figure.update_yaxes(rangemode="tozero", row=2, col=2)
    figure.update_xaxes(gridcolor=LINE, zerolinecolor="#aab2bc", automargin=True)
    figure.update_yaxes(gridcolor=LINE, zerolinecolor="#aab2bc", automargin=True)
    figure.update_layout(
        height=820,
        boxmode="group",
        font={"family": FONT, "size": 13, "color": INK},
        paper_bgcolor="#fff",
        plot_bgcolor="#fff",
        margin={"l": 62, "r": 14, "t": 64, "b": 46},
        legend={
            "orientation": "h",
            "x": 0,
            "y": 1.06,
            "yanchor": "bottom",
            "xanchor": "left",
        },
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
            full_html=False, include_plotlyjs=True, config=config, div_id="evaluation"
        )
    )


def _bars(means: Sequence[Mean], factor: float) -> dict[str, Any]:
    """Error bars of means."""
    above = [factor * (m.high - m.value) if isfinite(m.high) else 0.0 for m in means]
    below = [factor * (m.value - m.low) for m in means]
    return {
        "type": "data",
        "symmetric": False,
        "array": above,
        "arrayminus": below,
        "thickness": 1,
    }


_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>
body {{ margin: 0 auto; padding: 20px 28px 48px; max-width: 1360px; color: {ink}; background: {ground};
  font: 15px/1.5 {font}; }}
h1 {{ font-size: 23px; font-weight: 600; margin: 6px 0 8px; }}
section {{ background: #fff; border: 1px solid {line}; border-radius: 10px; padding: 16px 18px; margin-top: 16px;
  overflow-x: auto; }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 14px; }}
th, td {{ text-align: right; padding: 3px 10px; border-bottom: 1px solid {line}; font-weight: 400; }}
th {{ color: {soft}; }}
</style></head><body><h1>{title}</h1><p>{facts}</p>
<section>{figure}</section>
<section><p>Interquartile means over motions and seeds, with bootstrap intervals of 95 %.</p>
<table><tr>{heads}</tr>{rows}</table></section>
</body></html>
"""
