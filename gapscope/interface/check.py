"""Check a case before a minute of work: whether it can be diagnosed, and what its recordings cannot tell."""

from __future__ import annotations

from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory

from gapscope.arm.case import Case
from gapscope.case_check.check import check_case, document
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.interface.models import case_file
from gapscope.interface.result import DocumentResult
from gapscope.reports.case_check import summary


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
        path = case_file(case, Path(aside)) if isinstance(case, Case) else Path(case)
        content = document(check_case(path, progress))
    return CheckResult("check", content, summary, itemgetter("remarks"))
