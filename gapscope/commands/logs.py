"""The commands for a log and a case before any diagnosis: ``inspect``, ``check``, ``audit``, ``agree``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from gapscope.arm.errors import InputError
from gapscope.commands.options import AsJson, CaseOption, CasePath, Folder
from gapscope.terminal import Progress, say, show, wrote


def inspect(
    logs: Annotated[list[Path], Argument(metavar="LOG...")],
    *,
    robot: str | None = None,
    out: CaseOption = None,
) -> None:
    """Say what is in a log, draw it, and write the case to start from.

    Args:
        logs: files or folders of one arm's recordings
        robot: URDF, MJCF or known name; default: the one in the log
        out: folder of the case to write, with a page and a picture
    """
    from gapscope.arm.io.locked_section import locked
    from gapscope.interface.logs import inspect as inspect_logs
    from gapscope.reports.inspection import check_unused

    if out is not None:
        # before the logs are read: a folder in use is refused
        check_unused(out)
    written: tuple[Path, ...] = ()
    with Progress(logs[0]) as progress, locked(out):
        result = inspect_logs(logs, robot, progress=progress)
        if out is not None:
            progress("writes the case")
            written = result.save(out)
    show(result, *written)


def check(
    case: CasePath,
    *,
    json_: AsJson = False,
) -> None:
    """Say in seconds whether a case can be diagnosed, and what its recordings cannot tell."""
    from gapscope.interface.logs import check as check_case

    with Progress(case) as progress:
        result = check_case(case, progress=progress)
    show(result, as_json=json_)
    # as bad input ends every command
    if not result.can_be_diagnosed:
        raise typer.Exit(InputError.exit_code)


def audit(
    robot: str,
    *,
    recording: Annotated[Path | None, Option(metavar="STATIC")] = None,
    out: Folder | None = None,
    json_: AsJson = False,
) -> None:
    """Say what is odd about a robot model, worst first, with the line in its file.

    Args:
        robot: URDF or MJCF file, kuka_iiwa, ..., or a case
        recording: static poses with torque: a recording or a case
        out: folder for audit.html and audit.json
    """
    from gapscope.arm.io.locked_section import locked
    from gapscope.arm.robots import KNOWN_ROBOTS
    from gapscope.interface.logs import audit as audit_robot

    with Progress(Path(robot).name) as progress, locked(out):
        result = audit_robot(robot, recording, progress=progress)
        written = () if out is None else result.save(out)
    show(result, as_json=json_)
    if json_:
        return
    if robot in KNOWN_ROBOTS:
        say(f"The inertials of {robot}: {KNOWN_ROBOTS[robot].source}.")
    wrote(*written)


def agree(
    case: CasePath,
    *,
    out: Folder | None = None,
    json_: AsJson = False,
) -> None:
    """Say which parameters agree in all recordings, and with what the others differ.

    Args:
        out: folder for agreement.html and agreement.json
    """
    from gapscope.arm.io.locked_section import locked
    from gapscope.interface.logs import agree as compare

    with Progress(case) as progress, locked(out):
        result = compare(case, progress=progress)
        written = () if out is None else result.save(out)
    show(result, *written, as_json=json_)
