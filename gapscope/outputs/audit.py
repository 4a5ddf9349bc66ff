"""An audit as files: the page, and ``audit.json``."""

from __future__ import annotations

from pathlib import Path

from gapscope.arm.io.json_file import write_json
from gapscope.model_audit.audit import Audit
from gapscope.model_audit.audit_json import document
from gapscope.outputs.folder import begin_results
from gapscope.reports.model_audit.page import write_page

DOCUMENT, REPORT = "audit.json", "audit.html"


def write_audit(audit: Audit, folder: Path) -> tuple[Path, ...]:
    """Write the page and, as the last, the document.

    Raises:
        GapscopeError: a file cannot be written.
    """
    begin_results(folder, DOCUMENT)
    content = document(audit)
    write_page(content, folder / REPORT)
    write_json(content, folder / DOCUMENT)
    return folder / REPORT, folder / DOCUMENT
