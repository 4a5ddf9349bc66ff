"""Renders an identification into one self-contained HTML file, in the style of the diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gapscope.arm.io.json_file import plain
from gapscope.arm.joint_units import common_unit
from gapscope.ident.checks.troubleshooting import FOUND
from gapscope.ident.identification import Identification
from gapscope.reports.identification import (
    examined,
    figures,
    filter_section,
    sections,
)
from gapscope.reports.pages import write_html


def render(
    result: Identification, document: Mapping[str, Any], path: Path | str
) -> None:
    """Write the report; the file loads nothing from elsewhere.

    Args:
        result: what was identified, for the curves.
        document: its document, for the tables.
        path: of the file.

    Raises:
        GapscopeError: ``path`` cannot be written.
    """
    content = plain(document, null_if_not_finite=True)
    found = [row for row in content["troubleshooting"] if row["verdict"] == FOUND]
    write_html(
        "identification/report.html",
        path,
        curves=figures.payload(result),
        document=content,
        heading=sections.heading(content),
        joints=sections.joints(content),
        friction=sections.friction(content),
        force=common_unit("N m", sections.joint_slides(content)),
        speed_force=common_unit("N m s/rad", sections.joint_slides(content)),
        links=sections.links(content),
        shown=examined.identifiability(content),
        intervals=examined.intervals(content),
        found=found,
        filter_sentence=filter_section.filter_sentence(content),
        innovations=filter_section.innovation_rows(content),
    )
