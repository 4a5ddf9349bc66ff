"""Audit a robot model: what is odd about it before any recording exists."""

from __future__ import annotations

from operator import itemgetter
from pathlib import Path

from gapscope.diagnosis.prepare import Progress, silent
from gapscope.interface.result import DocumentResult
from gapscope.model_audit.audit import audit_model, document
from gapscope.reports.audit import summary, write_page


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
    return DocumentResult("audit", document(found), summary, rows, write_page)
