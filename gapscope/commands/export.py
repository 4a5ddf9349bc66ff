"""The command ``gapscope export``: the corrected arm for other simulators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from gapscope.terminal import Progress, say, wrote


def export(
    corrected: Annotated[
        Path, Argument(help="corrected.yaml of a diagnosis", metavar="CORRECTED")
    ],
    out: Annotated[Path, Option(help="file to write", metavar="FILE")],
    file_format: Annotated[
        str,
        Option(
            "--format",
            help="urdf, mjcf or sdf: the whole arm; isaac_lab, mjlab, newton, genesis, drake, gazebo, ros2_control, "
            "playground or environment: a snippet in the simulator's words",
        ),
    ],
    case: Annotated[
        Path | None,
        Option(
            help="the case that was diagnosed: its nominal arm and data sheet",
            metavar="CASE",
        ),
    ] = None,
    robot: Annotated[
        str | None,
        Option(help="in its place: kuka_iiwa, ..., or a URDF", metavar="ROBOT"),
    ] = None,
    relative_meshes: Annotated[
        bool,
        Option(
            "--relative-meshes",
            help="name meshes from the folder of FILE, not absolutely",
        ),
    ] = False,
    randomise: Annotated[
        bool,
        Option(
            "--randomise",
            help="with ranges to draw from: the 95 % intervals of the diagnosis beside CORRECTED",
        ),
    ] = False,
    unit: Annotated[
        list[Path] | None,
        Option(
            "--unit",
            help="with --randomise: diagnosis of another unit, which the ranges hold too; may be repeated",
            metavar="DIR",
        ),
    ] = None,
) -> None:
    """Write the corrected arm for other simulators.

    What the format cannot hold is listed in the file and on the terminal.
    """
    from gapscope.arm.errors import InputError
    from gapscope.arm.nearest_name import check_known
    from gapscope.commands.inputs import read_arm_and_controller
    from gapscope.diagnosis.compare_units import read_ranges
    from gapscope.effects.corrected_file import error_context, read_corrected_arm
    from gapscope.envs.export.formats import ALL_FORMATS
    from gapscope.envs.export.formats import export as export_arm

    if unit and not randomise:
        raise InputError(
            "other units matter for ranges alone", "add --randomise", where="--unit"
        )
    check_known("format", file_format, ALL_FORMATS, where="--format")
    if (case is None) == (robot is None):
        raise InputError(
            "expected one of --case and --robot",
            "give the case that was diagnosed, with its data sheet; or a robot without one",
            where="--case",
        )
    with Progress(corrected.name) as progress:
        progress(f"writes {file_format}")
        arm, controller = read_arm_and_controller(str(robot if case is None else case))
        if out.exists() and out.resolve() in (corrected.resolve(), arm.urdf.resolve()):
            raise InputError(
                "would be overwritten", "choose another file with --out", file=out
            )
        found = read_corrected_arm(arm, corrected)
        ranges = read_ranges(corrected, found, tuple(unit or ())) if randomise else None
        with error_context(corrected, found.effects):
            left_out, odd = export_arm(
                found,
                file_format,
                out,
                relative=relative_meshes,
                controller=controller,
                ranges=ranges,
            )
    for title, lines in ((f"left out of {out.name}:", left_out), ("odd:", odd)):
        if lines:
            say(title, *(f"  {line}" for line in lines))
    wrote(out)
