"""An identification as files: report, document, and the identified arm as a case that other commands read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from gapscope.arm.io.atomic_write import atomic_write
from gapscope.effects.corrected_file import write_corrected
from gapscope.ident.identification import Identification, identify
from gapscope.ident.output.base_file import write_base
from gapscope.ident.output.identification_json import document, write_document
from gapscope.ident.output.identified_arm import (
    effects,
    expressible,
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


@dataclass(frozen=True)
class WrittenIdentification:
    """An identification and its files.

    Attributes:
        result: what was identified.
        paths: the files, the report first.
        left_out: what of the model the identified arm's files cannot express, or an empty string.
    """

    result: Identification
    paths: tuple[Path, ...]
    left_out: str


def write_identification(
    result: Identification,
    case_file: Path,
    folder: Path,
    progress: Callable[[str], None] = lambda message: None,
) -> WrittenIdentification:
    """Write report, identified arm and, as the last, ``identification.json``.

    The identified arm is a URDF of consistent bodies, a case beside it with the data sheet, and ``identified.yaml``
    with the effects that the catalogue has: ``predict``, ``replay`` and ``gap`` read the case with that as model.

    Args:
        result: what was identified.
        case_file: the case file, whose recordings the new case names.
        folder: of the results.
        progress: called with a few words at each step.

    Raises:
        GapscopeError: no physically consistent parameters were found, or a file cannot be written.
    """
    plain, left_out = result, ""
    if not expressible(result):
        progress("identifies what URDF, data sheet and effects can express")
        plain = _plain_identification(result)
        left_out = _left_out(result, plain)
        result = replace(result, warnings=(*result.warnings, left_out))
    progress("writes the report")
    _write_arm(plain, case_file, folder)
    write_base(result, folder / BASE)
    content = document(result, FILES)
    render(result, content, folder / REPORT)
    write_document(content, folder / DOCUMENT)
    names = (REPORT, DOCUMENT, CASE, URDF, EFFECTS, BASE)
    return WrittenIdentification(
        result, tuple(folder / name for name in names), left_out
    )


def _plain_identification(result: Identification) -> Identification:
    """The same case, fitted with what the files of the arm can express."""
    settings = replace(result.settings, plain=True)
    return identify(result.case, settings)


def _write_arm(result: Identification, case_file: Path, folder: Path) -> None:
    text = urdf_text(result)
    with atomic_write(folder / URDF) as aside:
        aside.write_text(text, encoding="utf-8")
    write_case_beside(with_sheet(result), case_file, folder / CASE, URDF)
    write_corrected(result.case.name, effects(result), folder / EFFECTS)


def _left_out(result: Identification, plain: Identification) -> str:
    """What the files of the arm cannot express, and what that costs on the held-out samples."""
    without = plain.validation[1].every.overall
    with_all = result.validation[1].every.overall
    return (
        f"{URDF}, {CASE} and {EFFECTS} cannot express friction that keeps its direction at rest, so they hold a fit "
        "without: "
        f"{without:.1%} relative error on the held-out samples, {with_all:.1%} with it"
    )
