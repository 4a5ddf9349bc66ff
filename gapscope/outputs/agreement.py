"""An agreement as files: the page, and ``agreement.json``."""

from __future__ import annotations

from pathlib import Path

from gapscope.arm.io.json_file import write_json
from gapscope.diagnosis.agreement.agreement import Agreement
from gapscope.diagnosis.agreement.agreement_json import document
from gapscope.outputs.folder import begin_results
from gapscope.reports.agreement.page import write_page

DOCUMENT, REPORT = "agreement.json", "agreement.html"


def write_agreement(found: Agreement, folder: Path) -> tuple[Path, ...]:
    """Write the page and, as the last, the document.

    Raises:
        GapscopeError: a file cannot be written.
    """
    begin_results(folder, DOCUMENT)
    content = document(found)
    write_page(content, folder / REPORT)
    write_json(content, folder / DOCUMENT)
    return folder / REPORT, folder / DOCUMENT
