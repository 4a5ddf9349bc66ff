"""One case from its files to its results."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from gapscope.arm.case import load_case
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.document.diagnosis_json import write_document
from gapscope.diagnosis.result import Diagnosis
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import (
    error_context,
    read_corrected,
    read_corrected_arm,
    write_corrected,
)
from gapscope.envs.replay import Replay, replay
from gapscope.provenance import made_from
from gapscope.reports.diagnosis import render
from gapscope.reports.diagnosis.summary import SummaryRow


def make_folder(folder: Path) -> None:
    """Make a folder that can be written to, before any work is done for it.

    Raises:
        GapscopeError: it cannot be made or written to.
    """
    probe = folder / f".gapscope-{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise GapscopeError(
            f"{folder}: cannot be written to ({error.strerror})",
            "choose another folder with --out, or mend its rights",
        ) from None


def diagnose_path(
    path: Path, out: Path, progress: Callable[[str], None] = lambda message: None
) -> Diagnosis:
    """Diagnose the case at a path and write ``corrected.yaml``, ``report.html`` and, as the last, ``diagnosis.json``.

    A ``diagnosis.json`` of an earlier run is removed first, so that one that is there is whole and of this run; its key
    ``made_from`` says what it was made from.
    """
    make_folder(out)
    try:
        (out / "diagnosis.json").unlink(missing_ok=True)
    except OSError as error:
        raise GapscopeError(
            f"{out / 'diagnosis.json'}: cannot be replaced ({error.strerror})",
            "remove it",
        ) from None
    progress("reads the case")
    case, source = load_case(path, any_unit=True), made_from(path)
    result = diagnose(case, progress)
    result = replace(result, document={**result.document, "made_from": source})
    progress("writes the report")
    write_corrected(case.name, result.effects, out / "corrected.yaml")
    render(result, out / "report.html")
    write_document(result.document, out / "diagnosis.json")
    return result


def diagnose_one_of_many(path: str, out: Path, folder: str) -> tuple[SummaryRow, int]:
    """Diagnose the case at a path as one of several: its row of the summary, and its exit code."""
    try:
        document = diagnose_path(Path(path), out / folder).document
    except GapscopeError as error:
        return SummaryRow(folder, folder, failure=str(error)), error.exit_code
    except (
        Exception
    ) as error:  # a fault of the program in one case does not stop the others either
        return SummaryRow(folder, folder, failure=f"{type(error).__name__}: {error}"), 1
    return SummaryRow(str(document["case"]), folder, document), 0


def corrected_arm(arm: NominalArm, model: Path | None) -> CorrectedArm:
    """The nominal arm, or the corrected one where a ``corrected.yaml`` is given, with its residual network.

    Raises:
        InputError: the file cannot be used, or names a joint that the arm does not have.
    """
    return CorrectedArm(arm) if model is None else read_corrected_arm(arm, model)


def load_for_prediction(case_path: Path, file: Path) -> tuple[NominalArm, Recording]:
    """The nominal arm of a case, and every row of a recording that may hold no more than t and q."""
    case = load_case(case_path, read_recordings=False)
    recording = load_recording(file, case.arm, case.importing, every_row=True)
    return case.arm, replace(recording, payload=case.payload_of(file))


def replay_file(
    case_path: Path,
    file: Path,
    model: Path | None,
    engine: str,
    progress: Callable[[str], None],
) -> Replay:
    """Replay a recording of a case on its nominal arm, or on the corrected one."""
    progress("reads")
    case = load_case(case_path, read_recordings=False)
    recording = replace(
        load_recording(file, case.arm, case.importing), payload=case.payload_of(file)
    )
    effects = (
        read_corrected(model) if model is not None else ()
    )  # a simulator has no place for a residual network
    with error_context(model, effects):
        CorrectedArm(case.arm, effects).check()
    progress(f"replays {recording.duration:.3g} s in {engine}")
    with error_context(model, effects):
        return replay(case.arm, effects, recording, case.controller, engine=engine)
