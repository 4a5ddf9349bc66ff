"""The pictures of a blind check: accuracy over severity, reliability, confusion."""

from __future__ import annotations

from typing import Any

import plotly.graph_objects as go

from gapscope.reports.plot_page import COLOURS

QUANTITIES = (("top", "top-1"), ("exact", "exact set"), ("joints", "joints"))


def severity_figure(figures: dict[str, Any]) -> go.Figure:
    """Shares with Wilson's intervals over severity classes of single effects."""
    groups = figures["by_severity"]
    figure = go.Figure(layout={"colorway": COLOURS})
    for key, name in QUANTITIES:
        shares = [groups[group][key] for group in groups]
        rates = [share["rate"] or 0.0 for share in shares]
        pairs = list(zip(shares, rates, strict=True))
        intervals = {
            "type": "data",
            "symmetric": False,
            "array": [share["high"] - rate for share, rate in pairs],
            "arrayminus": [rate - share["low"] for share, rate in pairs],
        }
        figure.add_scatter(
            x=list(groups), y=rates, name=name, mode="lines+markers", error_y=intervals
        )
    figure.update_layout(
        xaxis_title="own gap over the floor",
        yaxis_title="share right",
        yaxis_range=[0, 1.02],
    )
    return figure


def reliability_figure(figures: dict[str, Any]) -> go.Figure:
    """Share of findings that are right over their probability, beside the diagonal."""
    rows = figures["calibration"]["reliability"]
    figure = go.Figure(layout={"colorway": COLOURS})
    figure.add_scatter(
        x=[0, 1], y=[0, 1], mode="lines", name="calibrated", line={"dash": "dot"}
    )
    figure.add_scatter(
        x=[row["probability"] for row in rows],
        y=[row["right"] for row in rows],
        mode="markers+lines",
        name="findings",
        text=[f"{row['count']} findings" for row in rows],
    )
    figure.update_layout(xaxis_title="probability", yaxis_title="share right")
    return figure


def confusion_figure(figures: dict[str, Any]) -> go.Figure:
    """Truth against first answer, numbers of cases."""
    table = figures["confusion"]
    answers = sorted({answer for row in table.values() for answer in row})
    counts = [[row.get(answer, 0) for answer in answers] for row in table.values()]
    figure = go.Figure(
        go.Heatmap(
            z=counts, x=answers, y=list(table), text=counts, texttemplate="%{text}"
        )
    )
    figure.update_layout(
        xaxis_title="first answer",
        yaxis_title="truth",
        yaxis_autorange="reversed",
    )
    return figure
