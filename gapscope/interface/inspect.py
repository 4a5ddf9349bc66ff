"""Inspect logs: which columns are which channel, what looks wrong, and the case to start from."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import RenderableType

from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.log import Log, open_log
from gapscope.arm.robots import load_nominal_arm
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.diagnosis.set_up import Remark
from gapscope.inspection.draft import case_text, check_draft, judge_torques
from gapscope.inspection.inspection import Inspection, inspect_logs
from gapscope.interface.result import Result
from gapscope.reports.inspection import (
    CASE,
    CHANNEL_HEADS,
    PAGE,
    PICTURE,
    channel_rows,
    check_unused,
    names_of,
    panels_of,
    summary,
    write_page,
    write_picture,
)

DESCRIBED = "robot.urdf"
"""Name of the file of a robot that a log describes."""


@dataclass(frozen=True, repr=False)
class InspectionResult(Result):
    """What is in logs.

    Attributes:
        found: columns, channels, torques and what looks wrong.
        checked: what reading the drafted case showed.
        robot: as it was given, or ``None``.
        description: URDF text of the robot that a log describes, if none was given.
    """

    COLUMNS = CHANNEL_HEADS

    found: Inspection
    checked: list[Remark]
    robot: str | None = None
    description: str | None = None

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write ``inspection.png``, ``inspection.html`` and the case to start from, which must not be there yet."""
        out = Path(folder)
        check_unused(out)
        robot, found = self.robot, self.found
        if self.description is not None and found.arm is not None:
            out.mkdir(parents=True, exist_ok=True)
            found = replace(found, arm=replace(found.arm, urdf=out / DESCRIBED))
            with atomic_write(out / DESCRIBED) as aside:
                aside.write_text(self.description, encoding="utf-8")
            robot = DESCRIBED
        elif robot is not None and Path(robot).exists():
            way = os.path.relpath(Path(robot).resolve(), out.resolve())
            robot = Path(way).as_posix()
        picture, page, case = out / PICTURE, out / PAGE, out / CASE
        label, joints = found.main.label, names_of(found)
        write_picture(picture, label, panels_of(found, 0), joints)
        write_page(page, found, self.checked)
        with atomic_write(case) as aside:
            aside.write_text(case_text(found, out, robot), encoding="utf-8")
        return picture, page, case

    def shown(self) -> RenderableType:
        """Columns, torques, joints and what looks wrong."""
        return summary(self.found, self.checked)

    def table(self) -> Iterator[tuple[str, str, str, str]]:
        """A row for the time and for each channel: its columns, their unit, and what tells."""
        return channel_rows(self.found)


def inspect(
    logs: str | Path | Sequence[str | Path],
    robot: str | Path | None = None,
    *,
    progress: Progress = silent,
) -> InspectionResult:
    """Say what is in logs of one arm.

    Args:
        logs: a file or folder of any format of recordings, or several.
        robot: URDF, MJCF or known name; by default the one that a log describes.
        progress: called with a few words at each step.

    Raises:
        InputError: a log or the robot cannot be used, or no column holds positions.

    Examples:
        >>> import gapscope
        >>> gapscope.inspect("log.csv", "robot.urdf").save("my_arm")  # doctest: +SKIP
    """
    progress("reads")
    paths = [logs] if isinstance(logs, (str, Path)) else logs
    opened = [open_log(path) for path in paths]
    text = None if robot is not None else _description(opened)
    with TemporaryDirectory(prefix="gapscope_") as aside:
        given = robot
        if text is not None:
            given = Path(aside) / DESCRIBED
            given.write_text(text, encoding="utf-8")
        arm = None if given is None else load_nominal_arm(given)
        progress("looks at columns, units and torques")
        found = inspect_logs(opened, arm)
        progress("looks for faults of the set-up")
        found = judge_torques(found)
        checked = check_draft(found)
    named = None if robot is None else str(robot)
    return InspectionResult(found, checked, named, text)


def _description(logs: Sequence[Log]) -> str | None:
    """The robot that a log describes, or ``None`` if none does."""
    texts = (log.robot_description for log in logs)
    return next((text for text in texts if text is not None), None)
