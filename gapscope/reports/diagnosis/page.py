"""Renders a diagnosis into one self-contained HTML file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from gapscope.arm.io.json_file import plain
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.document.wording import capital
from gapscope.diagnosis.result import Diagnosis
from gapscope.model.change_findings import change_text
from gapscope.reports.diagnosis import figures, sections
from gapscope.reports.diagnosis.actions import actions
from gapscope.reports.diagnosis.arm_scene import arm_scene
from gapscope.reports.diagnosis.sides_section import sides
from gapscope.reports.pages import write_html


def render(diagnosis: Diagnosis, path: Path | str) -> None:
    """Write the report of a diagnosis; the file loads nothing from elsewhere.

    Raises:
        GapscopeError: the document is not valid, or ``path`` cannot be written.
    """
    validate(diagnosis.document)
    diagnosis = replace(diagnosis, document=plain(diagnosis.document))
    made = {part.__name__: part(diagnosis) for part in (*sections.SECTIONS, sides)}
    changes = diagnosis.document.get("changes", [])
    write_html(
        "diagnosis/report.html",
        path,
        curves=figures.payload(diagnosis) | {"arm": arm_scene(diagnosis)},
        actions=actions(diagnosis),
        document=diagnosis.document,
        changes=[capital(change_text(entry)) for entry in changes],
        **made,
    )
