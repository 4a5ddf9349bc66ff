"""A case diagnosed from its files to its results, alone or against a reference."""

from __future__ import annotations

from pathlib import Path

from gapscope.arm.io.atomic_write import begin_results
from gapscope.arm.io.locked_section import locked
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.interface.diagnose import DiagnosisResult, diagnose
from gapscope.reports.diagnosis import DOCUMENT


def diagnose_path(
    path: Path,
    out: Path,
    progress: Progress = silent,
    *,
    against: Path | None = None,
) -> tuple[DiagnosisResult, tuple[Path, ...]]:
    """Diagnose the case at a path and write the results; see ``gapscope.reports.diagnosis``.

    Args:
        path: the case.
        out: folder of the results, which is tried before the work starts.
        progress: called with a few words at each step.
        against: case of the same arm that it is compared with, or the folder of what was identified on one.

    Returns:
        The diagnosis and its files.
    """
    with locked(out):
        begin_results(out, DOCUMENT)
        result = diagnose(path, against=against, progress=progress)
        progress("writes the report")
        return result, result.save(out)
