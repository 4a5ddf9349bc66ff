"""The command ``gapscope record``: a case from a simulated arm with effects."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gapscope.commands.options import Engine, RobotArgument
from gapscope.terminal import Progress, note, wrote

Effects = Annotated[
    Path, typer.Option(help="effects, in the form of corrected.yaml", metavar="FILE")
]
Out = Annotated[Path, typer.Option(help="folder of the case to make", metavar="CASE")]
Motion = Annotated[
    str,
    typer.Option(
        help="fourier, point_to_point, weld_seam, pick, place, random, or a CSV that excite wrote"
    ),
]
Recordings = Annotated[int, typer.Option(help="how many, from slow to fast")]
Duration = Annotated[float, typer.Option(help="of each [s]")]
SampleRate = Annotated[float, typer.Option(help="samples per second [Hz]")]
Controller = Annotated[
    str | None,
    typer.Option(
        help="pd, pid, cascade or computed_torque, with gains that fit the arm, or a YAML file in the form of the "
        "controller: section of a case; by default as the case ROBOT has it, else pd",
        metavar="KIND|FILE",
    ),
]
ReadBack = Annotated[
    bool,
    typer.Option(
        "--read-back",
        help="record the torque that reached the joints, read back from the drives, in place of "
        "the torque commanded",
    ),
]
Noise = Annotated[
    float,
    typer.Option(help="noise of the torque, as a share of its standard deviation"),
]
EncoderNoise = Annotated[float, typer.Option(help="noise of the encoders [rad]")]
TableFormat = Annotated[str, typer.Option("--format", help="csv, parquet or npz")]
Seed = Annotated[
    int | None, typer.Option(min=0, help="draw the same motions and noise again")
]
Sealed = Annotated[
    Path | None,
    typer.Option(help="folder for the truth, outside the case", metavar="DIR"),
]


def record(
    robot: RobotArgument,
    effects: Effects,
    out: Out,
    trajectory: Motion = "fourier",
    recordings: Recordings = 4,
    duration: Duration = 10.0,
    rate: SampleRate = 250.0,
    controller: Controller = None,
    read_back: ReadBack = False,
    noise: Noise = 0.01,
    encoder_noise: EncoderNoise = 0.0,
    file_format: TableFormat = "csv",
    engine: Engine = None,
    seed: Seed = None,
    sealed: Sealed = None,
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
