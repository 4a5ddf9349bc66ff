"""The command ``gapscope predict``: the torque that a model predicts for a motion."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from gapscope.commands.options import CasePath, Model
from gapscope.terminal import Progress, wrote


def predict(
    case: CasePath,
    recording: Annotated[
        Path,
        Option(
            help="recording with t, q1.., a path or a name of the case; other columns are not used",
            metavar="FILE",
        ),
    ],
    out: Annotated[Path, Option(help="CSV to write: t, tau1..", metavar="FILE.csv")],
    model: Model = None,
) -> None:
    """Predict the torque that a model says would be recorded."""
    from gapscope.commands.inputs import read_recording
    from gapscope.interface.predict import predict as predict_recording

    with Progress(recording.name) as progress:
        progress("reads")
        loaded, motion = read_recording(case, recording, every_row=True)
        progress("predicts")
        predict_recording(loaded, motion, model).write(out)
    wrote(out)
