"""The summary of a diagnosis for a terminal, 80 columns wide."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from gapscope.arm.display import effect_name, nrmse, percent
from gapscope.diagnosis.document.sentences import (
    nominal_friction_sentence,
    possible_texts,
    presliding_sentence,
    sides_sentence,
    unexplained_sentence,
    verdict_sentence,
)
from gapscope.diagnosis.document.wording import (
    VERDICTS,
    acts_on,
    capital,
    gap_rows,
    holds_in,
    joint_names,
    joint_ranges,
    parameter_texts,
)
from gapscope.model.change_findings import change_text

_COLOURS = {
    "effects_found": "bold cyan",
    "no_gap": "bold green",
    "unexplained": "bold yellow",
}


def print_summary(document: Mapping[str, Any], console: Console) -> None:
    """Print verdict, effects, gap per joint, what is possible, what is open and the warnings."""
    label = Text(VERDICTS[document["verdict"]], style=_COLOURS[document["verdict"]])
    console.print(Text.assemble((document["case"], "bold"), ": ", label))
    console.print(Text(verdict_sentence(document)))
    if "against" in document:
        name, count = (
            document["against"]["reference"],
            len(document["against"]["recordings"]),
        )
        text = f"{name} ({count} recording{'s' if count != 1 else ''}); effects are changes since then"
        _labelled(console, "Compared with", text)
    for entry in document.get("changes", []):
        _labelled(console, "Changed during a recording", change_text(entry))
    if document["effects"]:
        console.print()
        console.print(_effects(document))
    console.print()
    console.print(_joints(document))
    if "sides" in document:
        console.print()
        _labelled(console, "By the torque sensors", sides_sentence(document))
    if document["possible"]:
        console.print()
    for text in possible_texts(document):
        _labelled(console, "Possible, not confirmed", text)
    if document["verdict"] != "no_gap":
        console.print()
        _labelled(console, "Unexplained", unexplained_sentence(document))
    friction = nominal_friction_sentence(document)
    if friction is not None:
        _labelled(console, "Nominal friction", friction)
    bent = presliding_sentence(document)
    if bent is not None:
        _labelled(console, "Dry friction builds up over", bent)
    if document["next_recording"]:
        _labelled(console, "Next recording", document["next_recording"])
    for warning in document.get("warnings", []):
        _labelled(console, "Warning", warning, "yellow")


def _effects(document: Mapping[str, Any]) -> Table:
    """One row per parameter of each effect."""
    table = _table()
    table.add_column("Effect", max_width=22)
    table.add_column("Joints", max_width=9)
    table.add_column("Value ± std")
    table.add_column("Prob.", justify="right", no_wrap=True)
    table.add_column("Share", justify="right", no_wrap=True)
    for effect in document["effects"]:
        place = acts_on(effect).removeprefix("the whole ")
        joints = ", ".join(joint_ranges(effect["joints"]))
        if not joints or place.startswith("motor"):
            joints = place
        lines = [f"{value.name} {value.text}" for value in parameter_texts(effect)]
        values = "\n".join([*lines, *holds_in(effect)])
        table.add_row(
            Text(capital(effect_name(effect["effect"]))),
            joints,
            Text(values),
            percent(effect["probability"]),
            percent(effect["share"]),
        )
    return table


def _joints(document: Mapping[str, Any]) -> Table:
    """Torque NRMSE of each joint before, after, and its floor."""
    table = _table()
    table.add_column("Joint", no_wrap=True)
    table.add_column("", max_width=30, no_wrap=True)
    for name in ("before", "after", "floor"):
        table.add_column(name, justify="right", no_wrap=True)
    for joint, (name, gaps) in enumerate(
        zip(joint_names(document), gap_rows(document), strict=True), 1
    ):
        table.add_row(
            str(joint), Text(name, overflow="ellipsis"), *(nrmse(gap) for gap in gaps)
        )
    table.title = Text("Torque gap (NRMSE, on data not used to fit)", style="bold")
    closed = document["closed"]
    if closed is not None and document["verdict"] != "no_gap":
        table.caption = Text(f"{percent(closed)} of the gap above the floor is closed")
    return table


def _table() -> Table:
    return Table(
        box=None,
        padding=(0, 2, 0, 0),
        title_justify="left",
        caption_justify="left",
        header_style="dim",
    )


def _labelled(console: Console, label: str, text: str, style: str = "bold") -> None:
    console.print(Text.assemble((f"{label}:", style), " ", text))
