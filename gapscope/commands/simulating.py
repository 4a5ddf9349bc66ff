"""The commands about simulated arms: record, export and demo."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

from gapscope.commands.options import Engine, RobotArgument
from gapscope.terminal import Progress, console, log, wrote


def record(
    robot: RobotArgument,
    effects: Annotated[
        Path,
        typer.Option(help="effects, in the form of corrected.yaml", metavar="FILE"),
    ],
    out: Annotated[
        Path, typer.Option(help="folder of the case to make", metavar="CASE")
    ],
    trajectory: Annotated[
        str,
        typer.Option(
            help="fourier, point_to_point, weld_seam, pick, place, random, or a CSV that excite wrote"
        ),
    ] = "fourier",
    recordings: Annotated[int, typer.Option(help="how many, from slow to fast")] = 4,
    duration: Annotated[float, typer.Option(help="of each [s]")] = 10.0,
    rate: Annotated[float, typer.Option(help="samples per second [Hz]")] = 250.0,
    controller: Annotated[
        str,
        typer.Option(
            help="pd (as the case ROBOT has it, else with nominal feedforward), or a YAML file in the form of the "
            "controller: section of a case",
            metavar="KIND|FILE",
        ),
    ] = "pd",
    read_back: Annotated[
        bool,
        typer.Option(
            "--read-back",
            help="record the torque that reached the joints, read back from the drives, in place of "
            "the torque commanded",
        ),
    ] = False,
    noise: Annotated[
        float,
        typer.Option(help="noise of the torque, as a share of its standard deviation"),
    ] = 0.01,
    encoder_noise: Annotated[
        float, typer.Option(help="noise of the encoders [rad]")
    ] = 0.0,
    file_format: Annotated[
        str, typer.Option("--format", help="csv, parquet or npz")
    ] = "csv",
    engine: Engine = "pybullet",
    seed: Annotated[
        int | None, typer.Option(min=0, help="draw the same motions and noise again")
    ] = None,
    sealed: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(help="folder for the truth, outside the case", metavar="DIR"),
    ] = None,
) -> None:
    """Record a simulated arm with effects as a case.

    The truth is kept in truth.yaml, in the case or sealed elsewhere.
    """
    from gapscope.commands.record import record_files
    from gapscope.envs.session import Plan

    plan = Plan(
        trajectory, recordings, duration, rate, read_back, noise, encoder_noise, engine
    )
    with Progress(out.name or str(out)) as progress:
        paths, note = record_files(
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
    if note:
        log.print(f"note: {note}", highlight=False, markup=False, soft_wrap=True)
    wrote(*paths)


def export(
    corrected: Annotated[
        Path, typer.Argument(help="corrected.yaml of a diagnosis", metavar="CORRECTED")
    ],
    out: Annotated[Path, typer.Option(help="file to write", metavar="FILE")],
    file_format: Annotated[str, typer.Option("--format", help="urdf, mjcf or sdf")],
    case: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            help="the case that was diagnosed: its nominal arm and data sheet",
            metavar="CASE",
        ),
    ] = None,
    robot: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(help="in its place: kuka_iiwa, ..., or a URDF", metavar="ROBOT"),
    ] = None,
    relative_meshes: Annotated[
        bool,
        typer.Option(
            "--relative-meshes",
            help="name meshes from the folder of FILE, not absolutely",
        ),
    ] = False,
) -> None:
    """Write the corrected arm for other simulators.

    What the format cannot hold is listed in the file and on the terminal.
    """
    from gapscope.commands.export import export_file

    with Progress(corrected.name) as progress:
        progress(f"writes {file_format}")
        missing, odd = export_file(
            corrected, case, robot, file_format, out, relative_meshes
        )
    for title, lines in (
        (f"left out of {out.name}:", missing),
        ("odd:", odd),
    ):
        for line in (title, *(f"  {each}" for each in lines)) if lines else ():
            console.print(line, highlight=False, markup=False, soft_wrap=True)
    wrote(out)


def demo(
    out: Annotated[
        Path, typer.Option(help="folder for the case and the results", metavar="DIR")
    ] = Path("gapscope-demo"),
    seed: Annotated[
        int | None, typer.Option(help="draw the same mystery arm again")
    ] = None,
) -> None:
    """Record a mystery arm, diagnose it, and open the truth."""
    from gapscope.commands.demo import play

    with Progress("mystery arm") as progress:
        paths = play(out, seed, progress, console)
    wrote(*paths)
