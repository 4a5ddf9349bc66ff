"""Audit a robot model: what is odd about it before any recording exists."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType

from gapscope.interface.result import Result
from gapscope.model_audit.audit import Audit, audit_model, document
from gapscope.reports.audit import summary, write_audit

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, repr=False)
class AuditResult(Result):
    """What is odd about a model.

    Attributes:
        audit: the file as it stands, and the findings.
    """

    audit: Audit

    @property
    def document(self) -> dict[str, Any]:
        """The content of ``audit.json``."""
        return document(self.audit)

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write ``audit.html`` and, as the last, ``audit.json``."""
        return write_audit(self.audit, Path(folder))

    def shown(self) -> RenderableType:
        """The findings of each kind, worst first."""
        return summary(self.document)

    def to_frame(self) -> pd.DataFrame:
        """A row for each finding, worst first."""
        import pandas as pd

        return pd.DataFrame(self.document["findings"])


def audit(
    robot: str | Path,
    recording: str | Path | None = None,
    *,
    progress: Callable[[str], None] = lambda message: None,
) -> AuditResult:
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
    return AuditResult(
        audit_model(robot, None if recording is None else Path(recording))
    )
