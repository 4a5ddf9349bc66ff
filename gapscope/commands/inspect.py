"""The command ``gapscope inspect``: what is in a log, and the case to start from."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from gapscope.arm.errors import InputError
from gapscope.terminal import Progress, console, wrote

if TYPE_CHECKING:
    from gapscope.arm.io.log import Log

Logs = Annotated[
    list[Path],
    typer.Argument(help="files or folders of one arm's recordings", metavar="LOG..."),
]
Robot = Annotated[
    str | None,
    typer.Option(help="URDF, MJCF or known name; default: the one in the log"),
]
Out = Annotated[
    Path | None,
    typer.Option(help="folder of the case to write, with a page and a picture", metavar="CASE"),
]  # fmt: skip


def inspect(logs: Logs, robot: Robot = None, out: Out = None) -> None:
    """Say what is in a log, draw it, and write the case to start from."""
    from gapscope.arm.folder_lock import locked
    from gapscope.arm.io.log import open_log
    from gapscope.arm.robots import load_nominal_arm
    from gapscope.inspection.draft_check import check_draft
    from gapscope.inspection.inspection import inspect_logs
    from gapscope.outputs.inspection import save_inspection
    from gapscope.reports.inspection.terminal_summary import summary

    if out is not None:
        _check_unused(out)
    with (
        Progress(logs[0].name) as progress,
        TemporaryDirectory() as aside,
        locked(out),
    ):
        progress("reads")
        opened = [open_log(path) for path in logs]
        given = robot or _description(opened, out or Path(aside))
        arm = load_nominal_arm(given) if given else None
        progress("looks at columns, units and torques")
        found = inspect_logs(opened, arm)
        progress("looks for faults of the set-up")
        checked = check_draft(found)
        written = []
        if out is not None:
            progress("writes the case")
            written = save_inspection(found, checked, out, _named_from(out, given))
    console.print(summary(found, checked))
    wrote(*written)


def _check_unused(folder: Path) -> None:
    """A case that is there may have been edited, so that it is never replaced."""
    case = folder / "case.yaml"
    if case.exists():
        raise InputError(
            "is there already, and may have been edited",
            "name another folder with --out, or remove it",
            file=case,
        )


def _description(logs: Sequence[Log], folder: Path) -> str | None:
    """File of the robot that a log describes, or ``None`` if none does."""
    from gapscope.arm.io.atomic_write import atomic_write

    for log in logs:
        if log.robot_description is not None:
            path = folder / "robot.urdf"
            with atomic_write(path) as aside:
                aside.write_text(log.robot_description, encoding="utf-8")
            return str(path)
    return None


def _named_from(folder: Path, robot: str | None) -> str | None:
    """What the case says as its robot: a known name, or a path relative to its folder."""
    if robot is None or not Path(robot).exists():
        return robot
    return Path(os.path.relpath(Path(robot).resolve(), folder.resolve())).as_posix()
