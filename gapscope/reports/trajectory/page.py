"""A trajectory as a page of plots that opens without a network."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.nominal import NominalArm
from gapscope.ident.excitation.excitation_plan import ExcitationPlan

if TYPE_CHECKING:
    from gapscope.ident.excitation.design import Excitation

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#1f2328")
"""One colour per joint, distinguished by colour-blind people too; they repeat, dashed, after the seventh joint."""
POINTS = 2000
"""Most points of a curve."""
FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", "Liberation Sans", Arial, sans-serif'
INK, SOFT, LINE, GROUND = "#1f2328", "#5b6470", "#e6e9ed", "#f6f7f9"


def write_page(
    found: Excitation, arm: NominalArm, plan: ExcitationPlan, path: Path
) -> None:
    """Write position, velocity, acceleration and torque of all joints over time, and the margins to the limits.

    Raises:
        GapscopeError: the file cannot be written.
    """
    page = _PAGE.format(
        font=escape(FONT),
        ink=INK,
        soft=SOFT,
        line=LINE,
        ground=GROUND,
        title=escape(f"Exciting trajectory of {arm.name}"),
        facts=escape(
            f"{plan.kind}, {plan.length:g} s, criterion {plan.criterion}: condition number {found.condition:.3g} of "
            f"{len(found.names)} base columns scaled to unit norm, {found.inertial_condition:.3g} of the inertial ones "
            "alone."
        ),
        figure=_figure(found),
        rows=_rows(found),
        heads="".join(f"<th>{escape(name)}</th>" for name in arm.joints),
    )
    with atomic_write(path) as aside:
        aside.write_text(page, encoding="utf-8")


def _figure(found: Excitation) -> str:
    """The figure with plotly's code, as HTML."""
    from plotly.graph_objects import Scatter
    from plotly.subplots import make_subplots

    motion = found.motion
    step = -(-len(motion.t) // POINTS)
    panels = (
        ("position [rad]", motion.q),
        ("velocity [rad/s]", motion.dq),
        ("acceleration [rad/s²]", motion.ddq),
        ("torque [N m]", found.torque),
    )
    figure = make_subplots(
        rows=len(panels), cols=1, shared_xaxes=True, vertical_spacing=0.03
    )
    for row, (title, series) in enumerate(panels, 1):
        for j, values in enumerate(series.T):
            line = {
                "color": COLOURS[j % len(COLOURS)],
                "width": 1.6,
                "dash": "solid" if j < len(COLOURS) else "dash",
            }
            figure.add_trace(
                Scatter(
                    x=motion.t[::step].round(4),
                    y=values[::step].round(5),
                    name=f"J{j + 1}",
                    legendgroup=str(j),
                    showlegend=row == 1,
                    line=line,
                    mode="lines",
                ),
                row=row,
                col=1,
            )
        figure.update_yaxes(
            title={"text": title, "standoff": 8}, automargin=True, row=row, col=1
        )
    figure.update_xaxes(gridcolor=LINE, zerolinecolor="#aab2bc")
    figure.update_yaxes(gridcolor=LINE, zerolinecolor="#aab2bc")
    figure.update_xaxes(title={"text": "time [s]"}, row=len(panels), col=1)
    figure.update_layout(
        height=920,
        font={"family": FONT, "size": 13, "color": INK},
        margin={"l": 62, "r": 14, "t": 34, "b": 46},
        paper_bgcolor="#fff",
        plot_bgcolor="#fff",
        hovermode="x unified",
        legend={
            "orientation": "h",
            "x": 0,
            "y": 1,
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
            full_html=False, include_plotlyjs=True, config=config, div_id="trajectory"
        )
    )


def _rows(found: Excitation) -> str:
    """Rows of the table of margins."""
    joints, out = found.motion.q.shape[1], []
    for margin in found.margins:
        pairs = zip(
            np.atleast_1d(margin.margin), np.atleast_1d(margin.limit), strict=True
        )
        span = "" if margin.limit.ndim else f' colspan="{joints}"'
        cells = "".join(f"<td{span}>{m:.3g} ({limit:.4g})</td>" for m, limit in pairs)
        out.append(f"<tr><th>{margin.name} [{margin.unit}]</th>{cells}</tr>")
    return "".join(out)


_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>
body {{ margin: 0 auto; padding: 20px 28px 48px; max-width: 1360px; color: {ink}; background: {ground};
  font: 15px/1.5 {font}; }}
h1 {{ font-size: 23px; font-weight: 600; margin: 6px 0 8px; }}
section {{ background: #fff; border: 1px solid {line}; border-radius: 10px; padding: 16px 18px; margin-top: 16px; }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 14px; }}
th, td {{ text-align: right; padding: 3px 10px; border-bottom: 1px solid {line}; font-weight: 400; }}
th {{ color: {soft}; }}
</style></head><body><h1>{title}</h1><p>{facts}</p>
<section>{figure}</section>
<section><p>Least margin to each limit, over all samples; in brackets the limit.</p>
<table><tr><th></th>{heads}</tr>{rows}</table></section>
</body></html>
"""
