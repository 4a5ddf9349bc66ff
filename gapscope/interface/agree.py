"""Compare the recordings of a case: which parameters agree, which differ, and which value to trust."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gapscope.arm.case import Case
from gapscope.diagnosis.agreement import agreement, document
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.interface.models import case_of
from gapscope.interface.result import Document, DocumentResult
from gapscope.reports.agreement import summary, write_page


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
    content = document(agreement(case_of(case), progress))
    return DocumentResult("agreement", content, summary, _rows, write_page)


def _rows(content: Document) -> Iterator[dict[str, Any]]:
    """A row for each parameter and recording: verdict, value and standard deviation."""
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
