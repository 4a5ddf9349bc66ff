"""Diagnosis of a case against a reference, from files to results."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from gapscope.arm.case import load_case
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.commands.diagnose import make_folder
from gapscope.diagnosis.document.diagnosis_json import write_document
from gapscope.diagnosis.reference.change import Change
from gapscope.diagnosis.reference.diagnose_change import diagnose_change
from gapscope.effects.corrected_file import write_corrected
from gapscope.ident.output.identified_arm import write_case_beside
from gapscope.reports.diagnosis import render

CASE, URDF = "identified_case.yaml", "identified.urdf"


def diagnose_against(
    path: Path,
    reference: Path,
    out: Path,
    progress: Callable[[str], None] = lambda message: None,
) -> Change:
    """Diagnose the case at a path against a reference, and write what ``diagnose`` writes and the identified arm.

    ``identified_case.yaml`` is the case with the identified arm as its nominal one; with ``corrected.yaml`` as model it
    predicts the torque recorded in the case.

    Raises:
        InputError: the reference cannot be used; its message names the reference.
    """
    make_folder(out)
    try:
        (out / "diagnosis.json").unlink(missing_ok=True)
    except OSError as error:
        raise GapscopeError(
            f"{out / 'diagnosis.json'}: cannot be replaced ({error.strerror})",
            "remove it",
        ) from None
    if path.resolve() == reference.resolve():
        raise InputError(
            "is the case itself",
            "give recordings of the same arm from a day on which it was healthy",
            where=f"--against {reference}",
        )
    progress("reads the case and the reference")
    case, healthy = load_case(path, any_unit=True), load_case(reference)
    change = diagnose_change(case, healthy, out, progress)
    progress("writes the report")
    source = path / "case.yaml" if path.is_dir() else path
    write_case_beside(replace(change.today, case=change.case), source, out / CASE, URDF)
    write_corrected(case.name, change.corrected, out / "corrected.yaml")
    render(change.diagnosis, out / "report.html")
    write_document(change.diagnosis.document, out / "diagnosis.json")
    return change
