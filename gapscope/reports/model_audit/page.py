"""An audit as a page that opens without a network."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gapscope.reports.model_audit.lines import groups, heading, number, place
from gapscope.reports.pages import write_html


def write_page(content: dict[str, Any], path: Path) -> None:
    """Write the findings, worst first, and the table of the links.

    Args:
        content: the document.
        path: the page.

    Raises:
        GapscopeError: the file cannot be written.
    """
    odd = {finding["place"] for finding in content["findings"]}
    write_html(
        "model_audit/audit.html",
        path,
        content=content,
        heading=heading(content),
        groups=groups(content),
        place=place,
        number=number,
        odd=odd,
    )
