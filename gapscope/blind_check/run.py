"""The run: every case of a blind set diagnosed with what is frozen at its start, the labels out of reach."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed

from gapscope.arm.case import load_case
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.json_file import read_json, write_json
from gapscope.blind_check.frozen import frozen
from gapscope.blind_check.seal import (
    read_commitment,
    readable_labels,
)
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.document.diagnosis_json import write_document
from gapscope.effects.corrected_file import write_corrected
from gapscope.provenance import sha256, source_hash

FROZEN = "frozen.json"
"""File of the results with what the run is fixed by, and at its end the hash of each diagnosis."""
DONE = "run.json"
"""File of a case's results, written last: seconds, and why it failed if it did."""


def run(
    cases: Path,
    out: Path,
    *,
    labels: Path | None = None,
    jobs: int = 1,
    progress: Callable[[str], None] = lambda message: None,
) -> int:
    """Diagnose every case; those that have been are kept, those that failed are tried again.

    Args:
        cases: folder that ``make`` wrote.
        out: folder of the results, one sub-folder per case.
        labels: where the labels lie, to make sure that they cannot be read.
        jobs: cases at a time.
        progress: called with a few words after each case.

    Returns:
        The number of cases that failed.

    Raises:
        InputError: the labels can be read, there is no commitment, or the run was begun with another source.
    """
    commitment = read_commitment(cases)
    found = readable_labels(cases, labels)
    if found is not None:
        raise InputError(
            "the labels can be read from here, so the check would not be blind",
            "move the folder of the labels to where this user cannot read it (another machine or user, or an "
            "encrypted archive), and bring it back for gapscope blind score",
            file=found,
        )
    folders = sorted(path.parent for path in cases.glob("*/case.yaml"))
    if len(folders) != commitment["cases"]:
        raise InputError(
            f"holds {len(folders)} cases, but {commitment['cases']} were committed to",
            "restore the missing ones, or make the set again",
            file=cases,
        )
    _freeze(out, commitment)
    todo = [folder for folder in folders if not _finished(out / folder.name)]
    done = len(folders) - len(todo)
    failed = 0
    work = (delayed(_one)(folder, out / folder.name) for folder in todo)
    results = Parallel(n_jobs=jobs, return_as="generator_unordered")(work)
    for name, problem in results:
        done += 1
        failed += bool(problem)
        why = f": {problem}" if problem else ""
        progress(f"{done} of {len(folders)} done, {name}{why}")
    _close(out, [folder.name for folder in folders])
    return failed


def _freeze(out: Path, commitment: dict[str, Any]) -> None:
    """Write what the run is fixed by, or compare it with what an earlier part of the run was fixed by."""
    now = {"schema": 1, "labels_sha256": commitment["labels_sha256"], **frozen()}
    file = out / FROZEN
    if not file.is_file():
        write_json(now, file)
        return
    before = read_json(file, "choose another folder with --out")
    for key, what in (
        ("labels_sha256", "these are results on another set"),
        ("source_sha256", "the source changed"),
    ):
        if before[key] != now[key]:
            raise InputError(
                f"{what} since this run was begun",
                "choose another folder with --out",
                file=file,
            )


def _finished(folder: Path) -> bool:
    file = folder / DONE
    return file.is_file() and read_json(file, "remove it")["error"] is None


def _one(case: Path, out: Path) -> tuple[str, str]:
    """Diagnose one case; its name, and why it failed."""
    begin, problem = time.perf_counter(), None
    try:
        result = diagnose(load_case(case, any_unit=True))
        write_corrected(
            case.name,
            result.effects,
            out / "corrected.yaml",
            presliding=result.presliding,
            states=result.states,
        )
        write_document(result.document, out / "diagnosis.json")
    except GapscopeError as error:
        problem = str(error)
    except Exception as error:
        # one case does not stop the rest; the scorer counts it as failed
        problem = f"{type(error).__name__}: {error}"
    write_json(
        {"seconds": round(time.perf_counter() - begin, 2), "error": problem}, out / DONE
    )
    return case.name, "" if problem is None else problem.splitlines()[0]


def _close(out: Path, names: list[str]) -> None:
    """Add the hash of each diagnosis and, once more, of the source, so that the scorer sees what was touched."""
    content = json.loads((out / FROZEN).read_text(encoding="utf-8"))
    content["diagnoses"] = {name: diagnosis_hash(out / name) for name in names}
    content["source_sha256_at_the_end"] = source_hash()
    write_json(content, out / FROZEN)


def diagnosis_hash(folder: Path) -> str | None:
    """SHA-256 of the diagnosis in a folder; ``None`` if there is none."""
    file = folder / "diagnosis.json"
    return sha256(file) if file.is_file() else None
