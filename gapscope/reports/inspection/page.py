"""What is in a log as a page that opens without a network."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gapscope.inspection.draft_check import DraftCheck
from gapscope.inspection.inspection import TORQUES, Inspection
from gapscope.reports.inspection.panels import Panel, panels_of
from gapscope.reports.plot_page import (
    COLOURS,
    PageSection,
    figure_html,
    write_plot_page,
)

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

LEGEND = {"orientation": "h", "x": 0, "y": 1, "yanchor": "bottom", "xanchor": "left"}
"""Place of the names of the joints: above the first panel."""
DRAWN = 4
"""Most recordings that are drawn."""


def write_page(path: Path, found: Inspection, checked: DraftCheck) -> None:
    """Write what is in the logs, what looks wrong, and the plots.

    Args:
        path: of the page.
        found: what is in the logs.
        checked: what reading the draft showed.

    Raises:
        GapscopeError: the file cannot be written.
    """
    sections = [
        PageSection("What looks wrong", "" if wrong_rows(found, checked) else "Nothing.",
                    heads=("where", "what", "what to do"), rows=wrong_rows(found, checked), numbers=False),
        PageSection("What the columns are taken for", heads=("channel", "columns", "unit", "because"),
                    rows=list(channel_rows(found)), numbers=False),
        PageSection("What the torque can be", heads=("columns", "seen"), rows=list(torque_rows(found)), numbers=False),
        PageSection("Joints", heads=("joint", "from", "to", "fastest"), rows=list(joint_rows(found)), numbers=False),
        *_plots(found),
    ]  # fmt: skip
    names = ", ".join(log.path.name for log in found.logs[:3])
    more = f" and {len(found.logs) - 3} more" if len(found.logs) > 3 else ""
    write_plot_page(path, f"What is in {names}{more}", facts_of(found), sections)


def facts_of(found: Inspection) -> str:
    """Formats, recordings, rates and durations in a sentence."""
    formats = ", ".join(sorted({log.format for log in found.logs}))
    times = [next(iter(entry.values())).time for entry in found.entries]
    rates = sorted({f"{time.rate:.4g}" for time in times}, key=float)
    durations = [float(time.seconds[-1]) for time in times]
    certain = "" if times[0].certain else " (not told by the log)"
    count = len(found.entries)
    return (
        f"{formats}: {count} recording{'s' if count > 1 else ''} of {found.n_joints} joints, "
        f"{', '.join(rates)} Hz{certain}, {min(durations):.1f} to {max(durations):.1f} s."
    )


def wrong_rows(found: Inspection, checked: DraftCheck) -> list[tuple[str, str, str]]:
    """What looks wrong: where, what, what to do."""
    rows = [
        (
            "torque and motion",
            fault,
            "gapscope diagnose says how sure that is and mends the case",
        )
        for fault in checked.faults
    ]
    if checked.problem:
        rows.append(("the drafted case", checked.problem, ""))
    rows += [(odd.where, odd.what, odd.remedy) for odd in found.oddities]
    notes = (*found.notes, *checked.notes)
    for note in notes:
        where, _, what = note.partition(": ")
        # the reader and the case may say the same of a table
        if all(what != said for _, said, _ in rows):
            rows.append((where, what, ""))
    return rows


def channel_rows(found: Inspection) -> Iterator[tuple[str, str, str, str]]:
    """Time and channels: columns, unit, reason."""
    time = found.main.time
    yield (
        "time",
        time.column or "-",
        time.unit or f"rows at {time.rate:.4g} Hz",
        time.why,
    )
    for channel, (_, guess) in found.chosen.items():
        yield channel, guess.group.pattern, guess.unit, guess.why


def torque_rows(found: Inspection) -> Iterator[tuple[str, str]]:
    """What was seen of each column that may be a torque."""
    taken = [guess for _, guess in found.chosen.values()]
    for label, table in found.sources.items():
        for guess in table.channels:
            if guess.channel in TORQUES:
                facts = found.torques[label, guess.group.pattern]
                used = f" (taken as {guess.channel})" if guess in taken else ""
                yield (
                    f"{guess.group.pattern}{used}",
                    "; ".join(facts) or "nothing strikes",
                )


def joint_rows(found: Inspection) -> Iterator[tuple[str, str, str, str]]:
    """Range and speed of each joint over all recordings, as the log has them."""
    # other topics may name the joints in another order
    label, _ = found.chosen["q"]
    tables = [entry[label] for entry in found.entries]
    series = [(t.time.seconds, guess) for t in tables if (guess := t.best("q"))]
    unit = series[0][1].unit
    for j, name in enumerate(names_of(found)):
        columns = [guess.group.values[:, j] for _, guess in series]
        low, high = min(c.min() for c in columns), max(c.max() for c in columns)
        fastest = max(
            abs(np.gradient(c, t)).max()
            for c, (t, _) in zip(columns, series, strict=True)
        )
        yield name, f"{low:.4g} {unit}", f"{high:.4g} {unit}", f"{fastest:.3g} {unit}/s"


def names_of(found: Inspection) -> list[str]:
    """Names of the joints: those of the columns, or numbers."""
    group = found.chosen["q"][1].group
    if group.by_name:
        return list(group.labels)
    return [f"J{j + 1}" for j in range(group.width)]


def _plots(found: Inspection) -> Iterator[PageSection]:
    for number, entry in enumerate(found.entries[:DRAWN]):
        panels = panels_of(found, number)
        label = next(iter(entry.values())).label
        figure = _figure(panels, names_of(found))
        html = figure_html(
            figure,
            f"log{number}",
            190 * len(panels) + 120,
            margin={"l": 70, "r": 14, "t": 34, "b": 46},
            legend=LEGEND,
        )
        yield PageSection(label, figure=html)
    if len(found.entries) > DRAWN:
        yield PageSection(
            note=f"The other {len(found.entries) - DRAWN} recordings are not drawn."
        )


def _figure(panels: Sequence[Panel], joints: Sequence[str]) -> Figure:
    from plotly.graph_objects import Scatter
    from plotly.subplots import make_subplots

    figure = make_subplots(
        rows=len(panels), cols=1, vertical_spacing=0.25 / len(panels)
    )
    for row, panel in enumerate(panels, start=1):
        for j, curve in enumerate(panel.curves.T):
            line = {
                "color": COLOURS[j % len(COLOURS)],
                "width": 1.2,
                "dash": "solid" if j < len(COLOURS) else "dash",
            }
            trace = Scatter(x=_rounded(panel.x), y=_rounded(curve), name=joints[j], legendgroup=str(j),
                            showlegend=row == 1, line=line, mode="lines")  # fmt: skip
            figure.add_trace(trace, row=row, col=1)
        kind = "log" if panel.spectrum else "linear"
        figure.update_yaxes(
            title={"text": panel.title, "standoff": 8}, type=kind, row=row, col=1
        )
        text = "frequency [Hz]" if panel.spectrum else "time [s]"
        figure.update_xaxes(
            title={"text": text, "standoff": 2}, type=kind, row=row, col=1
        )
    return figure


def _rounded(values: np.ndarray) -> list[float]:
    """Five significant digits: a page should stay small."""
    return [float(f"{value:.5g}") for value in values]
