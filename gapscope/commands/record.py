"""The command ``gapscope record``: a case from a simulated arm with effects."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from gapscope.commands.options import Engine, RobotArgument
from gapscope.terminal import Progress, note, wrote


def record(
    robot: RobotArgument,
    effects: Annotated[
        Path, Option(help="effects, in the form of corrected.yaml", metavar="FILE")
    ],
    out: Annotated[Path, Option(help="folder of the case to make", metavar="CASE")],
    trajectory: Annotated[
        str,
        Option(
            help="fourier, point_to_point, weld_seam, pick, place, random, or a CSV that excite wrote"
        ),
    ] = "fourier",
    recordings: Annotated[int, Option(help="how many, from slow to fast")] = 4,
    duration: Annotated[float, Option(help="of each [s]")] = 10.0,
    rate: Annotated[float, Option(help="samples per second [Hz]")] = 250.0,
    controller: Annotated[
        str | None,
        Option(
            help="pd, pid, cascade or computed_torque, with gains that fit the arm, or a YAML file in the form of the "
            "controller: section of a case; by default as the case ROBOT has it, else pd",
            metavar="KIND|FILE",
        ),
    ] = None,
    read_back: Annotated[
        bool,
        Option(
            "--read-back",
            help="record the torque that reached the joints, read back from the drives, in place of "
            "the torque commanded",
        ),
    ] = False,
    noise: Annotated[
        float,
        Option(help="noise of the torque, as a share of its standard deviation"),
    ] = 0.01,
    encoder_noise: Annotated[float, Option(help="noise of the encoders [rad]")] = 0.0,
    file_format: Annotated[str, Option("--format", help="csv, parquet or npz")] = "csv",
    engine: Engine = None,
    seed: Annotated[
        int | None, Option(min=0, help="draw the same motions and noise again")
    ] = None,
    sealed: Annotated[
        Path | None,
        Option(help="folder for the truth, outside the case", metavar="DIR"),
    ] = None,
) -> None:
    """Record a simulated arm with effects as a case.

    The truth is kept in truth.yaml, in the case or sealed elsewhere.
    """
    from gapscope.commands.recorded_case import record_files
    from gapscope.envs.engines import check_engine
    from gapscope.envs.recorder import Plan

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
    with Progress(out.name or str(out)) as progress:
        paths, remark = record_files(
            robot,
            effects,
            out,
            plan,
            controller=controller,
            seed=seed,
            ending=file_format,
            sealed=sealed,
            progress=progress,
        )
    if remark:
        note(f"note: {remark}")
    wrote(*paths)
