"""A diagnosis as files: ``report.html``, ``diagnosis.json`` and ``corrected.yaml``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gapscope.diagnosis.document.diagnosis_json import write_document
from gapscope.diagnosis.reference.change import Change
from gapscope.diagnosis.reference.reference_file import FOLDER, write_reference
from gapscope.diagnosis.result import Diagnosis
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected_file import write_corrected
from gapscope.ident.output.identified_arm import write_case_beside
from gapscope.reports.diagnosis import render

DOCUMENT, REPORT, CORRECTED = "diagnosis.json", "report.html", "corrected.yaml"
CASE, URDF = "identified_case.yaml", "identified.urdf"
"""The nominal arm that was identified on a reference."""


def write_diagnosis(result: Diagnosis, folder: Path) -> tuple[Path, ...]:
    """Write the corrected arm, the report and, as the last, ``diagnosis.json``.

    Returns:
        The files, the report first.

    Raises:
        GapscopeError: the document is not valid, or a file cannot be written.
    """
    return _write(result, result.effects, folder)


def write_change(change: Change, case_file: Path, folder: Path) -> tuple[Path, ...]:
    """Write what ``write_diagnosis`` writes and the arm identified on the reference.

    ``identified_case.yaml`` is the case with the identified arm as its nominal one; with ``corrected.yaml`` as model it
    predicts the torque recorded in the case. Its URDF is there already. A reference that was identified in this run is
    kept in the folder ``identified``.

    Args:
        change: what changed since the reference.
        case_file: the case file, whose recordings the new case names.
        folder: of the results.

    Returns:
        The files, the report first.

    Raises:
        GapscopeError: the document is not valid, or a file cannot be written.
    """
    write_case_beside(change.case.arm, case_file, folder / CASE, URDF)
    kept = []
    if change.reference.file is None:
        kept.append(write_reference(change.reference, folder / FOLDER))
    paths = _write(change.diagnosis, change.effects, folder, CASE, change.remainder)
    return (*paths, folder / CASE, folder / URDF, *kept)


def _write(
    result: Diagnosis,
    effects: Sequence[AppliedEffect],
    folder: Path,
    corrects: str | None = None,
    remainder: np.ndarray | None = None,
) -> tuple[Path, ...]:
    write_corrected(
        str(result.document["case"]),
        tuple(effects),
        folder / CORRECTED,
        presliding=result.presliding,
        corrects=corrects,
        remainder=remainder,
        states=result.states,
    )
    render(result, folder / REPORT)
    write_document(result.document, folder / DOCUMENT)
    return folder / REPORT, folder / DOCUMENT, folder / CORRECTED
