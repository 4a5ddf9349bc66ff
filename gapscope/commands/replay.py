"""The command ``gapscope replay``: the simulated arm under the commands of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from gapscope.commands.options import CasePath, Engine, Model
from gapscope.terminal import Progress, say, wrote


def replay(
    case: CasePath,
    recording: Annotated[
        Path,
        Option(
            help="recording with q_ref1.., or tau1.. without; a path or a name of the case",
            metavar="FILE",
        ),
    ],
    out: Annotated[
        Path, Option(help="CSV to write: t, q1.., tau1..", metavar="FILE.csv")
    ],
    model: Model = None,
    engine: Engine = None,
) -> None:
    """Move the simulated arm under the same commands as a recording."""
    from gapscope.commands.inputs import read_recording
    from gapscope.interface.replay import replay as replay_recording

    with Progress(recording.name) as progress:
        progress("reads")
        loaded, motion = read_recording(case, recording)
        replayed = replay_recording(
            loaded, motion, model, engine=engine, progress=progress
        )
        replayed.write(out)
    say(replayed.summary())
    wrote(out)
