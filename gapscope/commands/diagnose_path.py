"""A case diagnosed from its files to its results, alone or against a reference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from gapscope.arm.case import load_case
from gapscope.arm.errors import InputError
from gapscope.commands.inputs import case_file
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.reference.diagnose_change import diagnose_change
from gapscope.diagnosis.result import Diagnosis
from gapscope.outputs.diagnosis import DOCUMENT, write_change, write_diagnosis
from gapscope.outputs.folder import begin_results
from gapscope.provenance import KEY, made_from


def diagnose_path(
    path: Path, out: Path, progress: Callable[[str], None] = lambda message: None
) -> tuple[Diagnosis, tuple[Path, ...]]:
    """Diagnose the case at a path and write the results; see ``gapscope.outputs.diagnosis``.

    The key ``made_from`` of ``diagnosis.json`` says what it was made from.

    Returns:
        The diagnosis and its files.
    """
    begin_results(out, DOCUMENT)
    progress("reads the case")
    case = load_case(path, any_unit=True)
    source = made_from(path)
    result = diagnose(case, progress)
    result = replace(result, document={**result.document, KEY: source})
    progress("writes the report")
    return result, write_diagnosis(result, out)


def diagnose_path_against(
    path: Path,
    reference: Path,
    out: Path,
    progress: Callable[[str], None] = lambda message: None,
) -> tuple[Diagnosis, tuple[Path, ...]]:
    """Diagnose the case at a path against a reference and write the results.

    Returns:
        The diagnosis and its files.

    Raises:
        InputError: the reference cannot be used; its message names the reference.
    """
    begin_results(out, DOCUMENT)
    if path.resolve() == reference.resolve():
        raise InputError(
            "is the case itself",
            "give recordings of the same arm from a day on which it was healthy",
            where=f"--against {reference}",
        )
    progress("reads the case and the reference")
    case = load_case(path, any_unit=True)
    healthy = load_case(reference)
    change = diagnose_change(case, healthy, out, progress)
    progress("writes the report")
    return change.diagnosis, write_change(change, case_file(path), out)
