"""The commands for a model and a recording: ``predict``, ``replay``, ``gap``, ``view``, ``export``."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Annotated

from typer import Option

from gapscope.commands.options import (
    AsJson,
    CaseOption,
    CasePath,
    Csv,
    Engine,
    File,
    Model,
    RobotName,
)
from gapscope.terminal import Progress, note, say, show, wrote


def predict(
    case: CasePath,
    *,
    recording: File,
    out: Csv,
    model: Model = None,
) -> None:
    """Predict the torque that a model says would be recorded.

    Args:
        recording: recording with t, q1.., a path or a name of the case; other columns are not used
        out: CSV to write: t, tau1..
    """
    from gapscope.arm.io.write_case import check_csv
    from gapscope.commands.inputs import read_recording
    from gapscope.interface.models import predict as predict_recording

    check_csv(out)
    with Progress(recording) as progress:
        progress("reads")
        loaded, motion = read_recording(case, recording, every_row=True)
        progress("predicts")
        predict_recording(loaded, motion, model).write(out)
    wrote(out)


def replay(
    case: CasePath,
    *,
    recording: File,
    out: Csv,
    model: Model = None,
    engine: Engine = None,
) -> None:
    """Move the simulated arm under the same commands as a recording.

    Args:
        recording: recording with q_ref1.., or tau1.. without; a path or a name of the case
        out: CSV to write: t, q1.., tau1..
    """
    from gapscope.arm.io.write_case import check_csv
    from gapscope.commands.inputs import read_recording
    from gapscope.interface.models import replay as replay_recording

    check_csv(out)
    with Progress(recording) as progress:
        progress("reads")
        loaded, motion = read_recording(case, recording)
        replayed = replay_recording(
            loaded, motion, model, engine=engine, progress=progress
        )
        replayed.write(out)
    say(replayed.summary())
    wrote(out)


def gap(
    case: CasePath,
    *,
    model: Model = None,
    json_: AsJson = False,
) -> None:
    """Measure the gap alone, per joint, of a nominal or corrected arm."""
    from gapscope.interface.models import gap as measure_gap

    with Progress(case) as progress:
        progress("measures the gap")
        measured = measure_gap(case, model)
    show(measured, as_json=json_)
    if not json_:
        for warning in measured.document["warnings"]:
            note(f"note: {warning}")


def view(
    case: CasePath,
    *,
    out: Annotated[Path, Option(metavar="FILE.mcap")],
    recording: str | None = None,
    model: Model = None,
    open_: bool = True,
) -> None:
    """Write recorded, predicted and remaining torque and the arm as one MCAP, and open Rerun if installed.

    Args:
        out: MCAP to write; a Foxglove layout beside it
        recording: name of a recording of the case; default: the first
        open_: open Rerun if it is installed
    """
    from gapscope.arm.case import load_case
    from gapscope.arm.errors import GapscopeError
    from gapscope.interface.models import predict as predict_recording
    from gapscope.interface.models import recording_of
    from gapscope.interface.models import replay as replay_recording
    from gapscope.reports.scene import Scene, write_layout, write_mcap

    layout = out.with_suffix(".foxglove.json")
    with Progress(case) as progress:
        progress("predicts and replays")
        loaded = load_case(case)
        chosen = recording_of(loaded, recording or 0)
        torque = predict_recording(loaded, chosen, model).tau
        moved, problem = None, ""
        # without a controller or a torque nothing moves; the rest is still worth a look
        try:
            moved = replay_recording(loaded, chosen, model).replay.q
        except GapscopeError as error:
            problem = str(error)
        scene = Scene(loaded.arm, chosen.t, chosen.q, chosen.tau, torque, moved)
        progress("writes")
        write_mcap(scene, out)
        write_layout(scene, layout)
    if problem:
        note(f"not replayed: {problem}")
    wrote(out, layout)
    viewer = shutil.which("rerun")
    if open_ and viewer:
        # not waited for: the viewer outlives the command
        subprocess.Popen([viewer, str(out)])
    elif open_:
        note(
            "Rerun is not installed (pip install rerun-sdk); Foxglove and PlotJuggler open the file too"
        )


def export(
    corrected: Path,
    *,
    out: File,
    format_: str,
    case: CaseOption = None,
    robot: RobotName = None,
    relative_meshes: bool = False,
    randomise: bool = False,
    unit: Annotated[list[Path] | None, Option(metavar="DIR")] = None,
) -> None:
    """Write the corrected arm for other simulators.

    What the format cannot hold is listed in the file and on the terminal.

    Args:
        corrected: corrected.yaml of a diagnosis
        out: file to write
        format_: urdf, mjcf or sdf: the whole arm; isaac_lab, mjlab, newton, genesis, drake, gazebo, ros2_control,
            playground or environment: a snippet in the simulator's words
        case: the case that was diagnosed: its nominal arm and data sheet
        robot: in its place: kuka_iiwa, ..., or a URDF
        relative_meshes: name meshes from the folder of FILE, not absolutely
        randomise: with ranges to draw from: the 95 % intervals of the diagnosis beside CORRECTED
        unit: with --randomise: diagnosis of another unit, which the ranges hold too; may be repeated
    """
    from gapscope.arm.errors import InputError
    from gapscope.arm.nearest_name import check_known
    from gapscope.commands.inputs import read_arm_and_controller
    from gapscope.diagnosis.compare_units import read_ranges
    from gapscope.effects.corrected_file import error_context, read_corrected_arm
    from gapscope.envs.export.formats import export as export_arm
    from gapscope.envs.export.plain_arm import TARGETS

    if unit and not randomise:
        raise InputError(
            "other units matter for ranges alone", "add --randomise", where="--unit"
        )
    check_known("format", format_, TARGETS, where="--format")
    if (case is None) == (robot is None):
        raise InputError(
            "expected one of --case and --robot",
            "give the case that was diagnosed, with its data sheet; or a robot without one",
            where="--case",
        )
    with Progress(corrected) as progress:
        progress(f"writes {format_}")
        arm, controller = read_arm_and_controller(str(robot if case is None else case))
        # the output may be another path to what is read
        if out.exists() and out.resolve() in (corrected.resolve(), arm.urdf.resolve()):
            raise InputError(
                "would be overwritten", "choose another file with --out", file=out
            )
        found = read_corrected_arm(arm, corrected)
        ranges = read_ranges(corrected, found, tuple(unit or ())) if randomise else None
        with error_context(corrected, found.effects):
            left_out, odd = export_arm(
                found,
                format_,
                out,
                relative=relative_meshes,
                controller=controller,
                ranges=ranges,
            )
    for title, lines in ((f"left out of {out.name}:", left_out), ("odd:", odd)):
        if lines:
            say(title, *(f"  {line}" for line in lines))
    wrote(out)
