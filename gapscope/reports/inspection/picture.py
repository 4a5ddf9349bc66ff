"""The panels of a log as a PNG, for a chat or an issue."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gapscope.arm.io.atomic_write import atomic_write
from gapscope.reports.inspection.panels import Panel
from gapscope.reports.plot_page import COLOURS, GRID, INK


def write_picture(
    path: Path, title: str, panels: Sequence[Panel], joints: Sequence[str]
) -> None:
    """Draw all panels, one above the other.

    Raises:
        GapscopeError: the file cannot be written.
    """
    # the object interface alone: pyplot would look for a display
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 2.1 * len(panels) + 0.8), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11, color=INK)
    all_axes = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
    for axes, panel in zip(all_axes, panels, strict=True):
        for j, curve in enumerate(panel.curves.T):
            style = "-" if j < len(COLOURS) else "--"
            axes.plot(
                panel.x,
                curve,
                style,
                color=COLOURS[j % len(COLOURS)],
                lw=1,
                label=joints[j],
            )
        if panel.spectrum:
            axes.set_xscale("log")
            axes.set_yscale("log")
        axes.set_ylabel(panel.title, fontsize=8)
        axes.set_xlabel("frequency [Hz]" if panel.spectrum else "time [s]", fontsize=8)
        axes.tick_params(labelsize=8)
        axes.grid(color=GRID)
        axes.margins(x=0.01)
    all_axes[0].legend(fontsize=7, ncols=min(7, len(joints)), loc="upper right")
    with atomic_write(path) as aside:
        figure.savefig(aside, dpi=110)
