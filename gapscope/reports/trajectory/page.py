"""A trajectory as a page of plots that opens without a network."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gapscope.arm.joint_units import common_unit
from gapscope.arm.nominal import NominalArm
from gapscope.ident.excitation.excitation_plan import ExcitationPlan
from gapscope.reports.plot_page import (
    COLOURS,
    PageSection,
    figure_html,
    write_plot_page,
)

if TYPE_CHECKING:
    from plotly.graph_objects import Figure, Scatter

    from gapscope.ident.excitation.design import Excitation

POINTS = 2000
"""Most points of a curve."""


def write_page(
    found: Excitation, arm: NominalArm, plan: ExcitationPlan, path: Path
) -> None:
    """Write position, velocity, acceleration and torque of all joints over time, and the margins to the limits.

    Raises:
        GapscopeError: the file cannot be written.
    """
    facts = (
        f"{plan.kind}, {plan.length:g} s, criterion {plan.criterion}: condition number {found.condition:.3g} of "
        f"{len(found.names)} base columns scaled to unit norm, {found.inertial_condition:.3g} of the inertial ones "
        "alone. Run the files that end in _slow first: the same path at a fraction of the speed."
    )
    figure = figure_html(
        _figure(found, arm.sliding),
        "trajectory",
        920,
        hovermode="x unified",
        margin={"l": 62, "r": 14, "t": 34, "b": 46},
        legend={
            "orientation": "h",
            "x": 0,
            "y": 1,
            "yanchor": "bottom",
            "xanchor": "left",
        },
    )
    margins = PageSection(
        note="Least margin to each limit, over all samples; in brackets the limit.",
        heads=("", *arm.joints),
        rows=list(_margins(found)),
    )
    title = f"Exciting trajectory of {arm.name}"
    write_plot_page(path, title, facts, [PageSection(figure=figure), margins])


def _figure(found: Excitation, sliding: Sequence[bool]) -> Figure:
    """One panel per quantity, one above the other, over the same time."""
    from plotly.subplots import make_subplots

    motion = found.motion
    panels = {
        f"{name} [{common_unit(unit, sliding)}]": series
        for name, unit, series in (
            ("position", "rad", motion.q),
            ("velocity", "rad/s", motion.dq),
            ("acceleration", "rad/s²", motion.ddq),
            ("torque", "N m", found.torque),
        )
    }
    figure = make_subplots(
        rows=len(panels), cols=1, shared_xaxes=True, vertical_spacing=0.03
    )
    for row, (title, series) in enumerate(panels.items(), 1):
        for joint, values in enumerate(series.T):
            curve = _curve(motion.t, values, joint)
            curve.showlegend = row == 1
            figure.add_trace(curve, row=row, col=1)
        figure.update_yaxes(title={"text": title, "standoff": 8}, row=row, col=1)
    figure.update_xaxes(title={"text": "time [s]"}, row=len(panels), col=1)
    return figure


def _curve(t: np.ndarray, values: np.ndarray, joint: int) -> Scatter:
    """A quantity of one joint; colours repeat, dashed, after the seventh joint."""
    from plotly.graph_objects import Scatter

    step = -(-len(t) // POINTS)  # rounded up
    line = {
        "color": COLOURS[joint % len(COLOURS)],
        "width": 1.6,
        "dash": "solid" if joint < len(COLOURS) else "dash",
    }
    return Scatter(
        x=t[::step].round(4),
        y=values[::step].round(5),
        name=f"J{joint + 1}",
        legendgroup=str(joint),
        line=line,
        mode="lines",
    )


def _margins(found: Excitation) -> Iterator[list[str]]:
    """Rows of the table of margins: one number per joint, or one for the whole arm."""
    for margin in found.margins:
        least = np.atleast_1d(margin.margin)
        limits = np.atleast_1d(margin.limit)
        pairs = zip(least, limits, strict=True)
        numbers = [f"{value:.3g} ({limit:.4g})" for value, limit in pairs]
        yield [f"{margin.name} [{margin.unit}]", *numbers]
