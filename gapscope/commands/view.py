"""The command ``gapscope view``: a recording, its prediction and the arm, for Foxglove, Rerun and PlotJuggler."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Annotated

from typer import Option

from gapscope.commands.options import CasePath, Model
from gapscope.terminal import Progress, note, wrote


def view(
    case: CasePath,
    out: Annotated[
        Path,
        Option(help="MCAP to write; a Foxglove layout beside it", metavar="FILE.mcap"),
    ],
    recording: Annotated[
        str | None,
        Option(help="name of a recording of the case; default: the first"),
    ] = None,
    model: Model = None,
    show: Annotated[
        bool, Option("--open/--no-open", help="open Rerun if it is installed")
    ] = True,
) -> None:
    """Write recorded, predicted and remaining torque and the arm as one MCAP, and open Rerun if installed."""
    from gapscope.interface.view import view as view_recording
    from gapscope.reports.scene import write_layout, write_mcap

    layout = out.with_suffix(".foxglove.json")

    with Progress(case.name or str(case)) as progress:
        progress("predicts and replays")
        scene, problem = view_recording(case, recording or 0, model)
        progress("writes")
        write_mcap(scene, out)
        write_layout(scene, layout)
    if problem:
        note(f"not replayed: {problem}")
    wrote(out, layout)
    viewer = shutil.which("rerun")
    if show and viewer:
        subprocess.Popen([viewer, str(out)])
    elif show:
        note(
            "Rerun is not installed (pip install rerun-sdk); Foxglove and PlotJuggler open the file too"
        )
