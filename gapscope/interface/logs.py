"""Inspect logs: which columns are which channel, what looks wrong, and the case to start from."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.console import RenderableType

from gapscope.arm.case import Case
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.log import open_log
from gapscope.arm.robots import load_nominal_arm
from gapscope.case_check.check import check_case
from gapscope.diagnosis.agreement import agreement
from gapscope.diagnosis.agreement import document as agreement_document
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.diagnosis.set_up import Remark
from gapscope.inspection.inspection import (
    Inspection,
    case_text,
    check_draft,
    inspect_logs,
    judge_torques,
)
from gapscope.interface.models import case_file, case_of
from gapscope.interface.result import Document, DocumentResult, Result
from gapscope.model_audit.audit import audit_model
from gapscope.reports import agreement as agreement_report
from gapscope.reports import audit as audit_report
from gapscope.reports import case_check as case_check_report
from gapscope.reports.inspection import (
    CASE,
    CHANNEL_HEADS,
    PAGE,
    PICTURE,
    channel_rows,
    check_unused,
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
        found: columns, channels and torques.
        checked: what looks wrong, by the drafted case.
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
        # a case that somebody has edited is not written over
        check_unused(out)
        robot, found = self.robot, self.found
        # the case needs the robot as a file beside it
        if self.description is not None and found.arm is not None:
            out.mkdir(parents=True, exist_ok=True)
            found = replace(found, arm=replace(found.arm, urdf=out / DESCRIBED))
            with atomic_write(out / DESCRIBED) as aside:
                aside.write_text(self.description, encoding="utf-8")
            robot = DESCRIBED
        elif robot is not None and Path(robot).exists():
            # relative, so that robot and case can be moved together
            way = os.path.relpath(Path(robot).resolve(), out.resolve())
            robot = Path(way).as_posix()
        picture, page, case = out / PICTURE, out / PAGE, out / CASE
        label, joints = found.main.label, found.names
        write_picture(picture, label, panels_of(found, 0), joints)
        write_page(page, found, self.checked)
        # the case last: with it the folder is whole
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
    # a path is a sequence of letters, too
    paths = [logs] if isinstance(logs, (str, Path)) else logs
    opened = [open_log(path) for path in paths]
    described = [log.robot_description for log in opened if log.robot_description]
    # a robot that is given counts more than one that a log describes; logs of one arm describe the same one
    text = next(iter(described), None) if robot is None else None
    with TemporaryDirectory(prefix="gapscope_") as aside:
        given = robot
        # a robot is read from a file, which is needed no longer than that
        if text is not None:
            given = Path(aside) / DESCRIBED
            given.write_text(text, encoding="utf-8")
        arm = None if given is None else load_nominal_arm(given)
        progress("looks at columns, units and torques")
        found = inspect_logs(opened, arm)
        progress("looks for faults of the set-up")
        # which column is the torque shows only against the arm
        found = judge_torques(found)
        # the case to start from is read back, as a user would read it
        checked = list(check_draft(found))
    named = None if robot is None else str(robot)
    return InspectionResult(found, checked, named, text)


class CheckResult(DocumentResult):
    """What the check of a case found."""

    @property
    def can_be_diagnosed(self) -> bool:
        """Whether no remark is an error."""
        return bool(self.document["can_be_diagnosed"])


def check(case: Case | str | Path, *, progress: Progress = silent) -> CheckResult:
    """Check a case in seconds: columns, units, rates, order, ranges, excitation, data sheet, controller, model.

    Args:
        case: the case, its folder or its case file.
        progress: called with a few words at each step.

    Examples:
        >>> import gapscope
        >>> gapscope.check("my_arm").can_be_diagnosed  # doctest: +SKIP
        True
    """
    with TemporaryDirectory(prefix="gapscope_") as aside:
        # the check reads files: a case in memory gets some
        path = case_file(case, Path(aside)) if isinstance(case, Case) else Path(case)
        content = check_case(path, progress)
    return CheckResult(
        "check", content, case_check_report.summary, itemgetter("remarks")
    )


def audit(
    robot: str | Path,
    recording: str | Path | None = None,
    *,
    progress: Progress = silent,
) -> DocumentResult:
    """Say what is odd about a model, worst first, each with the line of the file.

    Args:
        robot: URDF or MJCF file, known name, or case.
        recording: static poses with torque, a file in the columns of the case format or a case; gravity torque is then
            compared with the measured one.
        progress: called with a few words at each step.

    Raises:
        InputError: there is no such file, it is no robot, or the recording has no static poses.

    Examples:
        >>> import gapscope
        >>> gapscope.audit("kuka_iiwa").document["robot"]
        'lbr_iiwa'
    """
    progress("reads the model and its shapes")
    found = audit_model(robot, None if recording is None else Path(recording))
    rows = itemgetter("findings")
    return DocumentResult(
        "audit",
        found,
        audit_report.summary,
        rows,
        audit_report.write_page,
    )


def agree(case: Case | str | Path, *, progress: Progress = silent) -> DocumentResult:
    """Compare the recordings of a case, parameter by parameter.

    Args:
        case: the case, or its folder; held-out recordings are compared too.
        progress: called with a few words at each step.

    Raises:
        InputError: the case cannot be used, or has fewer than two recordings with torque.

    Examples:
        >>> import gapscope
        >>> gapscope.agree("my_arm").to_frame()  # doctest: +SKIP
    """
    progress("reads the case")
    content = agreement_document(agreement(case_of(case), progress))
    return DocumentResult(
        "agreement",
        content,
        agreement_report.summary,
        _agreement_rows,
        agreement_report.write_page,
    )


def _agreement_rows(content: Document) -> Iterator[dict[str, Any]]:
    """A row for each parameter and recording: verdict, value and standard deviation."""
    # long form: a row for each value, whatever the number of recordings
    for line in content["parameters"]:
        columns = zip(content["recordings"], line["values"], line["std"], strict=True)
        for recording, value, std in columns:
            yield {
                "parameter": line["key"],
                "unit": line["unit"],
                "verdict": line["verdict"],
                "recording": recording,
                "value": value,
                "std": std,
            }
