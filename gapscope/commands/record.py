"""The command ``gapscope record``: a case from a simulated arm with effects."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from gapscope.commands.options import Engine, File, Folder, NotNegative, RobotArgument
from gapscope.terminal import Progress, note, wrote


def record(
    robot: RobotArgument,
    *,
    effects: File,
    out: Annotated[Path, Option(metavar="CASE")],
    trajectory: str = "fourier",
    recordings: int = 4,
    duration: float = 10.0,
    rate: float = 250.0,
    controller: Annotated[str | None, Option(metavar="KIND|FILE")] = None,
    read_back: bool = False,
    noise: float = 0.01,
    encoder_noise: float = 0.0,
    format_: str = "csv",
    engine: Engine = None,
    seed: NotNegative | None = None,
    sealed: Folder | None = None,
) -> None:
    """Record a simulated arm with effects as a case.

    The truth is kept in truth.yaml, in the case or sealed elsewhere.

    Args:
        effects: effects, in the form of corrected.yaml
        out: folder of the case to make
        trajectory: fourier, point_to_point, weld_seam, pick, place, random, or a CSV that excite wrote
        recordings: how many, from slow to fast
        duration: of each [s]
        rate: samples per second [Hz]
        controller: pd, pid, cascade or computed_torque, with gains that fit the arm, or a YAML file in the form of the
            controller: section of a case; by default as the case ROBOT has it, else pd
        read_back: record the torque that reached the joints, read back from the drives, in place of the torque
            commanded
        noise: noise of the torque, as a share of its standard deviation
        encoder_noise: noise of the encoders [rad]
        format_: csv, parquet or npz
        seed: draw the same motions and noise again
        sealed: folder for the truth, outside the case
    """
    import numpy as np

    from gapscope.arm.io.atomic_write import make_folder
    from gapscope.arm.io.locked_section import locked
    from gapscope.arm.io.write_case import write_case
    from gapscope.arm.nearest_name import check_known
    from gapscope.commands.inputs import read_arm_and_controller
    from gapscope.commands.recorded_case import (
        ENDINGS,
        TRUTH,
        check_places,
        chosen_controller,
    )
    from gapscope.effects.corrected_file import (
        error_context,
        read_with_faults,
        write_corrected,
    )
    from gapscope.envs.engines import check_engine
    from gapscope.envs.recorder import Plan, hidden_by_reading_back, record_case

    plan = Plan(
        trajectory,
        recordings,
        duration,
        rate,
        read_back,
        noise,
        encoder_noise,
        check_engine(engine),
    )
    check_known("format", format_, ENDINGS, where="format")
    truth, faults = read_with_faults(effects)
    check_places(effects, out, sealed)
    arm, known = read_arm_and_controller(robot)
    law = chosen_controller(controller, arm, known)
    if sealed is not None:
        make_folder(sealed)
    rng, name = np.random.default_rng(seed), out.resolve().name

    def write_truth(folder: Path) -> None:
        write_corrected(name, truth, (sealed or folder) / TRUTH, faults=faults)

    with Progress(out.name or str(out)) as progress, locked(out):
        with error_context(effects, truth):
            made = (name, arm, truth, plan, rng)
            case = record_case(*made, controller=law, progress=progress)
            for fault in faults:
                case = fault.in_case(case, rng, arm)
        progress("writes the case")
        # with its truth in it from the start: without, it could not be told from a sealed one
        file = write_case(case, out, ending=format_, beside=write_truth)
    hidden = hidden_by_reading_back(truth) if read_back else ()
    if hidden:
        note(
            f"note: {', '.join(hidden)}: torque that is read back behind the drive hardly shows this; without "
            "--read-back the torque commanded is recorded"
        )
    wrote(file, (sealed or out) / TRUTH)
