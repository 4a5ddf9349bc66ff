"""The command ``gapscope inspect``: what is in a log, and the case to start from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from gapscope.terminal import Progress, show


def inspect(
    logs: Annotated[
        list[Path],
        Argument(help="files or folders of one arm's recordings", metavar="LOG..."),
    ],
    robot: Annotated[
        str | None,
        Option(help="URDF, MJCF or known name; default: the one in the log"),
    ] = None,
    out: Annotated[
        Path | None,
        Option(
            help="folder of the case to write, with a page and a picture",
            metavar="CASE",
        ),
    ] = None,
) -> None:
    """Say what is in a log, draw it, and write the case to start from."""
    from gapscope.arm.io.locked_section import locked
    from gapscope.interface.inspect import inspect as inspect_logs
    from gapscope.reports.inspection import check_unused

    if out is not None:
        check_unused(out)
    written: tuple[Path, ...] = ()
    with Progress(logs[0].name) as progress, locked(out):
        result = inspect_logs(logs, robot, progress=progress)
        if out is not None:
            progress("writes the case")
            written = result.save(out)
    show(result, *written)
