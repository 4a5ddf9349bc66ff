"""Check a case before a minute of work: whether it can be diagnosed, and what its recordings cannot tell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType

from gapscope.arm.case import Case
from gapscope.arm.io.atomic_write import begin_results
from gapscope.arm.io.json_file import write_json
from gapscope.case_check.check import CaseCheck, check_case, document
from gapscope.interface.models import case_file
from gapscope.interface.result import Result
from gapscope.reports.case_check import summary

if TYPE_CHECKING:
    import pandas as pd

DOCUMENT = "check.json"


@dataclass(frozen=True, repr=False)
class CheckResult(Result):
    """What the check of a case found.

    Attributes:
        found: the remarks, and how the joints move.
    """

    found: CaseCheck

    @property
    def document(self) -> dict[str, Any]:
        """The content of ``check.json``."""
        return document(self.found)

    @property
    def can_be_diagnosed(self) -> bool:
        """Whether no remark is an error."""
        return self.found.can_be_diagnosed

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write ``check.json``."""
        begin_results(Path(folder), DOCUMENT)
        path = Path(folder) / DOCUMENT
        write_json(self.document, path)
        return (path,)

    def shown(self) -> RenderableType:
        """All remarks, errors first, and how the joints move."""
        return summary(self.document)

    def to_frame(self) -> pd.DataFrame:
        """A row for each remark."""
        import pandas as pd

        return pd.DataFrame(self.document["remarks"])


def check(
    case: Case | str | Path, *, progress: Callable[[str], None] = lambda message: None
) -> CheckResult:
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
        path = case_file(case, Path(aside)) if isinstance(case, Case) else Path(case)
        return CheckResult(check_case(path, progress))
