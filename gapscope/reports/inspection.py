"""An inspection as a page, on the terminal and as files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text
from scipy.signal import welch

from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.table import BEYOND
from gapscope.arm.joint_units import joint_unit, units_of
from gapscope.diagnosis.set_up import Remark
from gapscope.inspection.inspection import TORQUES, Inspection
from gapscope.reports.pages import (
    COLOURS,
    GRID,
    INK,
    PageSection,
    Panel,
    figure_html,
    panels_figure,
    write_plot_page,
)

# What is drawn of a log: positions, velocities, torques and their spectra, one panel each.


POINTS = 3000
"""Most points of a curve."""
CHANNELS_DRAWN = {
    "q": "position",
    "q_ref": "reference",
    "dq": "velocity",
    "tau": "torque",
    "tau_sensor": "torque sensor",
}
"""Channels that are drawn over time, and their names."""


def panels_of(found: Inspection, number: int) -> list[Panel]:
    """Panels of one recording.

    Args:
        found: what is in the logs.
        number: of the recording, from 0.
    """
    panels, spectra = [], []
    for channel, name in CHANNELS_DRAWN.items():
        if channel not in found.chosen:
            continue
        label, _ = found.chosen[channel]
        table = found.entries[number][label]
        guess = table.best(channel)
        if guess is None:
            continue
        t, values, unit = table.time.seconds, guess.group.values, guess.unit
        step = -(-len(t) // POINTS)
        # values that no unit explains would flatten all others
        usual = np.abs(values) < BEYOND
        drawn = np.where(usual, values, np.nan)
        panels.append(Panel(f"{name} [{unit}]", t[::step], drawn[::step]))
        # amplitude spectral densities of what moves and of the torque; one such value would fill the whole spectrum
        if channel in ("q", "tau") and usual.all():
            rate = 1.0 / float(np.median(np.diff(t)))
            frequency, power = welch(values, rate, nperseg=min(len(t), 1024), axis=0)
            title = f"spectrum of {name} [{unit}/√Hz]"
            # without frequency zero, which a logarithmic axis does not have
            density = np.sqrt(power[1:])
            spectra.append(Panel(title, frequency[1:], density, spectrum=True))
    return [*panels, *spectra]


# The panels of a log as a PNG, for a chat or an issue.


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
            # more joints than colours
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
        axes.set_xlabel(panel.abscissa, fontsize=8)
        axes.tick_params(labelsize=8)
        axes.grid(color=GRID)
        axes.margins(x=0.01)
    all_axes[0].legend(fontsize=7, ncols=min(7, len(joints)), loc="upper right")
    with atomic_write(path) as aside:
        figure.savefig(aside, dpi=110)


# What is in a log as a page that opens without a network.


DRAWN = 4
"""Most recordings that are drawn."""


def write_page(path: Path, found: Inspection, checked: Sequence[Remark]) -> None:
    """Write what is in the logs, what looks wrong, and the plots.

    Args:
        path: of the page.
        found: what is in the logs.
        checked: what reading the draft showed.

    Raises:
        GapscopeError: the file cannot be written.
    """
    tables = tables_of(found, checked)
    # made last, read first
    wrong = tables.pop()
    wrong = replace(wrong, note="" if wrong.rows else "Nothing.")
    sections = [wrong, *tables, *_plots(found)]
    names = ", ".join(log.path.name for log in found.logs[:3])
    more = f" and {len(found.logs) - 3} more" if len(found.logs) > 3 else ""
    write_plot_page(path, f"What is in {names}{more}", facts_of(found), sections)


def tables_of(found: Inspection, checked: Sequence[Remark]) -> list[PageSection]:
    """What the columns are taken for, what the torque can be, the joints, and what looks wrong."""
    # what looks wrong: where, what, what to do
    first = (*found.misread, *checked)
    rows = [(one.place or one.topic, one.said, one.remedy) for one in first]
    for one in found.notes:
        # the drafted case may say the same of a table
        if all(one.said != said for _, said, _ in rows):
            rows.append((one.place, one.said, ""))
    return [
        PageSection("What the columns are taken for", CHANNEL_HEADS, list(channel_rows(found))),
        PageSection("What the torque can be", ("columns", "seen"), list(torque_rows(found))),
        PageSection("Joints", ("joint", "from", "to", "fastest"), list(joint_rows(found))),
        PageSection("What looks wrong", ("where", "what", "what to do"), rows),
    ]  # fmt: skip


def facts_of(found: Inspection) -> str:
    """Formats, recordings, rates and durations in a sentence."""
    formats = ", ".join(sorted({log.format for log in found.logs}))
    # the time of the first table stands for the recording
    times = [next(iter(entry.values())).time for entry in found.entries]
    rates = sorted({f"{time.rate:.4g}" for time in times}, key=float)
    seconds = [float(time.seconds[-1]) for time in times]
    durations = list(dict.fromkeys(f"{s:.1f}" for s in (min(seconds), max(seconds))))
    certain = "" if times[0].certain else " (not told by the log)"
    count = len(found.entries)
    return (
        f"{formats}: {count} recording{'s' if count > 1 else ''} of {found.n_joints} "
        f"joint{'s' if found.n_joints > 1 else ''}, {', '.join(rates)} Hz{certain}, {' to '.join(durations)} s."
    )


CHANNEL_HEADS = ("channel", "columns", "unit", "because")


def channel_rows(found: Inspection) -> Iterator[tuple[str, str, str, str]]:
    """Time and channels: columns, unit, reason."""
    time = found.main.time
    yield (
        "time",
        time.column or "-",
        time.unit or f"rows at {time.rate:.4g} Hz",
        time.why,
    )
    # a channel has one unit: that of slides only if nothing turns
    slides = found.arm is not None and all(found.arm.sliding)
    for channel, (_, guess) in found.chosen.items():
        yield channel, guess.group.pattern, joint_unit(guess.unit, slides), guess.why


def torque_rows(found: Inspection) -> Iterator[tuple[str, str]]:
    """What was seen of each column that may be a torque."""
    taken = [guess for _, guess in found.chosen.values()]
    for table in found.sources.values():
        for guess in table.channels:
            if guess.channel in TORQUES:
                used = f" (taken as {guess.channel})" if guess in taken else ""
                yield (
                    f"{guess.group.pattern}{used}",
                    "; ".join(guess.facts) or "nothing strikes",
                )


def joint_rows(found: Inspection) -> Iterator[tuple[str, str, str, str]]:
    """Range and speed of each joint over all recordings, as the log has them."""
    # other topics may name the joints in another order
    label, _ = found.chosen["q"]
    tables = [entry[label] for entry in found.entries]
    series = [(t.time.seconds, guess) for t in tables if (guess := t.best("q"))]
    units = [series[0][1].unit] * series[0][1].group.width
    if found.arm is not None:
        # columns beyond the joints of the arm keep the unit of the log
        units[: found.n_joints] = units_of(units[0], found.arm.sliding)
    for j, (name, unit) in enumerate(zip(found.names, units, strict=True)):
        columns = [guess.group.values[:, j] for _, guess in series]
        low, high = min(c.min() for c in columns), max(c.max() for c in columns)
        fastest = max(
            abs(np.gradient(c, t)).max()
            for c, (t, _) in zip(columns, series, strict=True)
        )
        yield name, f"{low:.4g} {unit}", f"{high:.4g} {unit}", f"{fastest:.3g} {unit}/s"


def _plots(found: Inspection) -> Iterator[PageSection]:
    for number, entry in enumerate(found.entries[:DRAWN]):
        panels = panels_of(found, number)
        label = next(iter(entry.values())).label
        spacing = 0.25 / len(panels)
        drawn = panels_figure(panels, found.names, vertical_spacing=spacing)
        html = figure_html(
            drawn,
            f"log{number}",
            190 * len(panels) + 120,
            margin={"l": 70, "r": 14, "t": 34, "b": 46},
            legend_at=1,
        )
        yield PageSection(label, figure=html)
    if len(found.entries) > DRAWN:
        yield PageSection(
            note=f"The other {len(found.entries) - DRAWN} recordings are not drawn."
        )


# What is in a log on the terminal.


def summary(found: Inspection, checked: Sequence[Remark]) -> Group:
    """Tables of columns, torques, joints and of what looks wrong."""
    parts: list[Text | Table] = [Text(facts_of(found))]
    tables = tables_of(found, checked)
    parts += [t.on_terminal(title_style="bold") for t in tables if t.rows]
    if not tables[-1].rows:
        parts.append(Text("Nothing looks wrong."))
    return Group(*parts)


# What ``gapscope inspect`` writes: the case to start from, a page and a picture.


CASE, PAGE, PICTURE = "case.yaml", "inspection.html", "inspection.png"
"""Files in the folder of results."""


def check_unused(folder: Path) -> None:
    """Check that no case is there, which may have been edited.

    Raises:
        InputError: one is.
    """
    if (folder / CASE).exists():
        raise InputError(
            "is there already, and may have been edited",
            "name another folder with --out, or remove it",
            file=folder / CASE,
        )
