"""The command ``gapscope replay``: the simulated arm under the commands of a recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gapscope.commands.options import CasePath, Engine, Model
from gapscope.terminal import Progress, say, wrote

if TYPE_CHECKING:
    from gapscope.envs.replay import Replay

Recording = Annotated[
    Path,
    typer.Option(
        help="recording with q_ref1.., or tau1.. without; a path or a name of the case",
        metavar="FILE",
    ),
]
Out = Annotated[
    Path, typer.Option(help="CSV to write: t, q1.., tau1..", metavar="FILE.csv")
]


def replay(
    case: CasePath,
    recording: Recording,
    out: Out,
    model: Model = None,
    engine: Engine = None,
) -> None:
    """Move the simulated arm under the same commands as a recording."""
    from gapscope.arm.io.write_case import write_columns
    from gapscope.reports.gap import replay_line

    with Progress(recording.name) as progress:
        replayed = replay_path(case, recording, model, engine, progress)
        positions = {f"q{j}": q for j, q in enumerate(replayed.q.T, 1)}
        torques = {f"tau{j}": tau for j, tau in enumerate(replayed.tau.T, 1)}
        write_columns({"t": replayed.t, **positions, **torques}, out)
    say(replay_line(replayed))
    wrote(out)


def replay_path(
    case_path: Path,
    file: Path,
    model: Path | None,
    engine: str | None,
    progress: Callable[[str], None],
) -> Replay:
    """Replay a recording of a case on its nominal arm, or on the corrected one.

    Raises:
        InputError: a file cannot be used, or an effect acts on a joint that the arm does not have.
    """
    from gapscope.commands.inputs import read_recording
    from gapscope.effects.corrected import CorrectedArm
    from gapscope.effects.corrected_file import error_context, read_corrected_arm
    from gapscope.envs.engines import check_engine
    from gapscope.envs.replay import replay as replay_recording
    from gapscope.interface.models import say_state

    progress("reads")
    case, recording = read_recording(case_path, file)
    corrected = CorrectedArm(case.arm)
    if model is not None:
        corrected = read_corrected_arm(case.arm, model)
        say_state(corrected, recording)
    effects = corrected.effects
    with error_context(model, effects):
        engine = check_engine(engine)
        progress(f"replays {recording.duration:.3g} s in {engine}")
        replayed = replay_recording(
            case.arm,
            effects,
            recording,
            case.controller,
            engine=engine,
            residual=corrected.residual,
            states=corrected.states,
        )
    return replace(replayed, t=recording.stamps)
