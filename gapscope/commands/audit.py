"""The command ``gapscope audit``: what is odd about a robot model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from gapscope.commands.options import AsJson
from gapscope.terminal import Progress, say, show, wrote


def audit(
    robot: Annotated[
        str,
        Argument(help="URDF or MJCF file, kuka_iiwa, ..., or a case", metavar="ROBOT"),
    ],
    recording: Annotated[
        Path | None,
        Option(
            help="static poses with torque: a recording or a case", metavar="STATIC"
        ),
    ] = None,
    out: Annotated[
        Path | None,
        Option(help="folder for audit.html and audit.json", metavar="DIR"),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Say what is odd about a robot model, worst first, with the line in its file."""
    from gapscope.arm.io.locked_section import locked
    from gapscope.arm.robots import KNOWN_ROBOTS
    from gapscope.interface.audit import audit as audit_robot

    with Progress(Path(robot).name) as progress, locked(out):
        result = audit_robot(robot, recording, progress=progress)
        written = () if out is None else result.save(out)
    show(result, as_json=as_json)
    if as_json:
        return
    if robot in KNOWN_ROBOTS:
        say(f"The inertials of {robot}: {KNOWN_ROBOTS[robot].source}.")
    wrote(*written)
