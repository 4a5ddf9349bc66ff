"""What ``gapscope inspect`` writes: the case to start from, a page and a picture."""

from __future__ import annotations

from pathlib import Path

from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.inspection.draft import case_text
from gapscope.inspection.draft_check import DraftCheck
from gapscope.inspection.inspection import Inspection
from gapscope.reports.inspection.page import names_of, write_page
from gapscope.reports.inspection.panels import panels_of
from gapscope.reports.inspection.picture import write_picture

CASE, PAGE, PICTURE = "case.yaml", "inspection.html", "inspection.png"
"""Files in the folder of results."""


def check_unused(folder: Path) -> None:
    """Check that no case is there, which may have been edited.

    Raises:
        InputError: one is.
    """
    if (folder / CASE).exists():
        raise InputError(
            "is there already, and may have been edited",
            "name another folder with --out, or remove it",
            file=folder / CASE,
        )


def save_inspection(
    found: Inspection, checked: DraftCheck, folder: Path, robot: str | None
) -> list[Path]:
    """Write picture, page and, last, the case to start from.

    Args:
        found: what is in the logs.
        checked: what reading the draft showed.
        folder: of the case.
        robot: what the case says as its robot; ``None`` if none is known.

    Raises:
        GapscopeError: a file cannot be written.
    """
    picture, page, case = folder / PICTURE, folder / PAGE, folder / CASE
    label = found.main.label
    write_picture(picture, label, panels_of(found, 0), names_of(found))
    write_page(page, found, checked)
    with atomic_write(case) as aside:
        aside.write_text(case_text(found, folder, robot), encoding="utf-8")
    return [picture, page, case]
