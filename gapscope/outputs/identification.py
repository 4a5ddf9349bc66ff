"""An identification as files: report, document, and the identified arm as a case that other commands read."""

from __future__ import annotations

from pathlib import Path

from gapscope.arm.io.atomic_write import atomic_write
from gapscope.effects.corrected_file import write_corrected
from gapscope.ident.identification import Identification
from gapscope.ident.output.base_file import write_base
from gapscope.ident.output.identification_json import document, write_document
from gapscope.ident.output.identified_arm import (
    effects,
    identified_bodies,
    presliding,
    urdf_text,
    with_sheet,
    write_case_beside,
)
from gapscope.reports.identification import render

DOCUMENT, REPORT, EFFECTS = "identification.json", "report.html", "identified.yaml"
CASE, URDF, BASE = "identified_case.yaml", "identified.urdf", "base_parameters.npz"
FILES = {
    "report": REPORT,
    "urdf": URDF,
    "case": CASE,
    "effects": EFFECTS,
    "base": BASE,
}
"""What is written beside the document, by purpose."""


def write_identification(
    result: Identification,
    case_file: Path,
    folder: Path,
) -> tuple[Path, ...]:
    """Write report, identified arm and, as the last, ``identification.json``.

    The identified arm is a URDF of consistent bodies, a case beside it with the data sheet, and ``identified.yaml``
    with the effects that the catalogue has: ``predict``, ``replay`` and ``gap`` read the case with that as model.

    Args:
        result: what was identified.
        case_file: the case file, whose recordings the new case names.
        folder: of the results.

    Raises:
        GapscopeError: no physically consistent parameters were found, or a file cannot be written.
    """
    _write_arm(result, case_file, folder)
    write_base(result, folder / BASE)
    content = document(result, FILES)
    render(result, content, folder / REPORT)
    write_document(content, folder / DOCUMENT)
    names = (REPORT, DOCUMENT, CASE, URDF, EFFECTS, BASE)
    return tuple(folder / name for name in names)


def _write_arm(result: Identification, case_file: Path, folder: Path) -> None:
    text = urdf_text(result.case.arm, identified_bodies(result))
    with atomic_write(folder / URDF) as aside:
        aside.write_text(text, encoding="utf-8")
    write_case_beside(with_sheet(result), case_file, folder / CASE, URDF)
    write_corrected(
        result.case.name,
        effects(result),
        folder / EFFECTS,
        presliding=presliding(result),
    )
