"""A residual network as a page, on the terminal and as files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Group
from rich.text import Text

from gapscope.arm.display import percent
from gapscope.arm.io.json_file import write_document
from gapscope.diagnosis.document.wording import Document
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.effects.corrected_file import write_corrected
from gapscope.effects.residual import write_residual
from gapscope.ident.residual.fit import LearntResidual, document
from gapscope.reports.pages import (
    COLOURS,
    PageSection,
    figure_html,
    subplots,
    write_plot_page,
)

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# A residual network as a page and on the terminal.


# Sentences about a learnt residual network, for the page and the terminal.


FORMS = {"additive": "sum of functions", "mlp": "MLP", "tcn": "TCN", None: "silent"}
"""What a form is called."""


def facts(content: Document) -> str:
    """What was trained on and what was set aside."""
    parts = []
    for key, words in (("fitted", "trained on"), ("judged", "judged on")):
        seconds = sum(one["seconds"] for one in content[key])
        # several pieces of a recording name it once
        names = ", ".join(dict.fromkeys(one["recording"] for one in content[key]))
        parts.append(f"{words} {seconds:.1f} s ({names})")
    return "; ".join(parts)


def joint_sentence(joint: Document) -> str:
    """What was chosen for a joint, and why."""
    tried = ", ".join(
        f"{FORMS[form]} {percent(closed)}"
        for form, closed in joint["closed_in_validation"].items()
    )
    # a network that closes nothing on unseen motion says nothing
    if joint["form"] is None:
        return (
            "The network is silent here: no form closes enough of every recording that it did not see "
            f"(closed of their squares: {tried})."
        )
    return (
        f"Form: {FORMS[joint['form']]}, its output times {joint['gain']:.2g}. Closed of the squares of fitted "
        f"recordings that a member had held out: {tried}. The torque is limited to {joint['bound']:.3g} N m. Means on "
        "the recordings set aside: dots for what the effects leave, lines for what the network says."
    )


def physics_sentence(content: Document) -> str:
    """How far the network stays apart from the physics."""
    physics = content["physics"]
    of = {
        "all": "inertial parameters, rotors, friction, offsets and the effects",
        "effects": "the parameters of the effects",
    }[physics["kept_apart_from"]]
    closed = physics["closed_by_apart"]
    tried = ""
    # of one way alone there was no choice to tell of
    if len(closed) > 1:
        shares = [f"{percent(share)} apart from {way}" for way, share in closed.items()]
        tried = f"Of what was held out networks close {', '.join(shares)}: this one is kept apart from {of}. "
    return (
        f"{tried}{percent(physics['share_of_residual'])} of the squares of the residual can be explained by {of}, and "
        f"are left to them. Of the network's output {physics['share_of_output']:.1e} lies there; refitted with the "
        f"network in place, a parameter of the effects would move by at most {physics['largest_move']:.1e} standard "
        "deviations."
    )


# A learnt residual network as a page that opens without a network.


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


def write_page(content: Document, path: Path) -> None:
    """Write the page of a document of the form of ``residual.schema.json``.

    Raises:
        GapscopeError: the file cannot be written.
    """
    physics = PageSection(
        title="Apart from the physics", note=physics_sentence(content)
    )
    joints = [_section(k, joint) for k, joint in enumerate(content["joints"], 1)]
    title = f"Residual network of {content['case']}"
    write_plot_page(path, title, facts(content), [_table(content), physics, *joints])


def _table(content: Document) -> PageSection:
    """Torque left per joint: by the corrected arm, with the network, with boosted trees."""
    rows = []
    for number, joint in enumerate(content["joints"], 1):
        left = joint["rmse"]
        # where nothing is left nothing can be closed
        squares = (left["network"] / left["nothing"]) ** 2 if left["nothing"] else 1.0
        values = [f"{left[key]:.3g}" for key in ("nothing", "network", "trees")]
        name, form = f"J{number} {joint['name']}", joint["form"] or "silent"
        rows.append([name, *values, percent(1 - squares), form])
    return PageSection(
        title="Torque left on the recordings set aside",
        note="RMS below 12 Hz, on motions that neither the network nor the trees were trained on.",
        heads=HEADS,
        rows=rows,
        numbers=True,
    )


def summary(content: Document) -> Group:
    """What the terminal shows: what was trained on, the torque left, and how far the network is from the physics."""
    said = Text(facts(content)), Text(physics_sentence(content))
    return Group(said[0], _table(content).on_terminal(box=None), said[1])


def _section(number: int, joint: Document) -> PageSection:
    """What a joint's network says, over its signals."""
    figure = figure_html(
        _figure(joint),
        f"joint{number}",
        HEIGHT,
        legend_at=1.02,
        margin={"l": 62, "r": 14, "t": 40, "b": 46},
    )
    title = f"Joint {number}, {joint['name']}"
    return PageSection(title=title, note=joint_sentence(joint), figure=figure)


def _figure(joint: Document) -> Figure:
    """Three panels: dots for what the corrected arm leaves, lines for what the network says."""
    figure = subplots(1, len(PANELS), shared_yaxes=True)
    named = set()
    for curve in joint["curves"]:
        column = list(PANELS).index(curve["over"]) + 1
        label, colour = STYLE[curve["direction"]]
        dots = {"color": colour, "size": 6, "opacity": 0.55}
        for key, mode, name in (
            ("residual", "markers", f"left by the effects, {label}"),
            ("network", "lines", f"network, {label}"),
        ):
            figure.add_scatter(
                x=curve["x"],
                y=curve[key],
                mode=mode,
                name=name,
                legendgroup=name,
                # each name once for all panels
                showlegend=name not in named,
                marker=dots,
                line={"color": colour, "width": 2},
                row=1,
                col=column,
            )
            named.add(name)
    for column, title in enumerate(PANELS.values(), 1):
        figure.update_xaxes(title={"text": title, "standoff": 6}, row=1, col=column)
    figure.update_yaxes(title={"text": "torque [N m]", "standoff": 8}, row=1, col=1)
    return figure


# A learnt residual network as files: the network, the corrected arm that names it, report and document.


DOCUMENT, REPORT = "residual.json", "report.html"
NETWORK, CORRECTED, ONNX = "residual.npz", "corrected.yaml", "residual.onnx"


def write_learnt(
    found: LearntResidual,
    folder: Path,
    *,
    onnx: bool = False,
    progress: Progress = silent,
) -> tuple[dict[str, Any], tuple[Path, ...]]:
    """Write the network, ``corrected.yaml`` with it, the report and, as the last, ``residual.json``.

    Args:
        found: what was learnt.
        folder: of the results.
        onnx: write ``residual.onnx`` as well.
        progress: called with a few words at each step.

    Returns:
        The document, and the paths, the report first.

    Raises:
        GapscopeError: a file cannot be written, or the package onnx is wanted and not installed.
    """
    # the one to open comes first
    files = {"report": REPORT, "corrected": CORRECTED, "network": NETWORK}
    if onnx:
        from gapscope.ident.residual.export import onnx_model

        progress("writes ONNX")
        onnx_model(found.residual, folder / ONNX)
        files["onnx"] = ONNX
    progress("writes the report")
    write_residual(found.residual, folder / NETWORK)
    corrected = found.corrected
    write_corrected(
        found.case.name,
        corrected.effects,
        folder / CORRECTED,
        NETWORK,
        presliding=corrected.arm.presliding,
        states=corrected.states,
    )
    content = document(found, files)
    write_page(content, folder / REPORT)
    write_document(content, folder / DOCUMENT, "residual")
    return content, tuple(folder / name for name in (*files.values(), DOCUMENT))
