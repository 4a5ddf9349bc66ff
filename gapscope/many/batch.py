"""Several cases in one run: one sub-folder each, a comparison of the units, and a summary."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from gapscope.arm.case import Case
from gapscope.arm.errors import GapscopeError, InterruptedRunError
from gapscope.arm.io.atomic_write import begin_results
from gapscope.arm.io.json_file import write_json
from gapscope.arm.io.locked_section import locked
from gapscope.diagnosis.compare_units import (
    ConfusionColumn,
    FleetUnit,
    confusion_column,
    explains_as_much,
    grouped,
    other_laws,
    unit_differences,
    units_document,
)
from gapscope.diagnosis.diagnose_change import FOLDER
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.document.wording import VERDICTS
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.effects.catalogue import without
from gapscope.interface.diagnose import DiagnosisResult, diagnose, kept_reference
from gapscope.many.pages import render_summary
from gapscope.many.rows import Row
from gapscope.many.units import fleet_tables
from gapscope.many.workers import LOCAL, RAY, check_backend, in_order
from gapscope.provenance import KEY, made_from
from gapscope.reports.diagnosis import CASE, CORRECTED, DOCUMENT, REPORT
from gapscope.terminal import console, say

SUMMARY, UNITS = "summary.html", "units.json"
AGAIN = ".of_type"
"""Ends the name of the folder of a unit that is asked again, until it takes the place of the first one."""


def diagnose_path(
    path: Case | Path,
    out: Path,
    progress: Progress = silent,
    *,
    against: Path | None = None,
) -> tuple[DiagnosisResult, tuple[Path, ...]]:
    """Diagnose the case at a path and write the results, from its files to its files.

    Args:
        path: the case, or where it is.
        out: folder of the results, which is tried before the work starts.
        progress: called with a few words at each step.
        against: case of the same arm that it is compared with, or the folder of what was identified on one.

    Returns:
        The diagnosis and its files.
    """
    with locked(out):
        # the old document goes first: a run that is stopped leaves no whole diagnosis
        begin_results(out, DOCUMENT)
        result = diagnose(path, against=against, progress=progress)
        progress("writes the report")
        return result, result.save(out)


@dataclass(frozen=True)
class Batch:
    """Several cases and where their results go.

    Attributes:
        cases: folders of cases, or case files.
        out: folder of the results.
        jobs: cases at a time.
        backend: ``local`` or ``ray``.
        again: whether to diagnose what has been diagnosed as well.
        against: reference of all cases, or the folder of what was identified on it; ``None``: no comparison.
    """

    cases: tuple[Path, ...]
    out: Path
    jobs: int = 1
    backend: str = "local"
    again: bool = False
    against: Path | None = None

    @cached_property
    def by_folder(self) -> dict[str, Path]:
        """The cases by the name of their results: of folder or file, numbered if it repeats or is ``identified``."""
        paths = [case.resolve() for case in self.cases]
        paths = [p.parent if p.name == "case.yaml" else p for p in paths]
        # a dot in the name of a folder is no ending
        names = [p.name if p.is_dir() else p.stem for p in paths]
        found: dict[str, Path] = {}
        for case, own in zip(self.cases, names, strict=True):
            name, number = own, len(found) + 1
            # the folder of the reference lies among those of the cases; a number must not make another case's name
            while name in (*found, FOLDER) or (name != own and name in names):
                name, number = f"{own}-{number}", number + 1
            found[name] = case
        return found


def diagnose_calls(
    calls: Sequence[tuple[Any, ...]], jobs: int, backend: str
) -> Iterator[Row]:
    """Make calls of ``diagnose_one_of_many``, so many at a time, and give each row in order, also of what failed."""
    if backend == RAY:
        # other machines have another current folder
        calls = [
            tuple(x.resolve() if isinstance(x, Path) else x for x in call)
            for call in calls
        ]
    results = in_order(diagnose_one_of_many, calls, jobs, backend)
    for (*_, folder, _, _), result in zip(calls, results, strict=True):
        yield _failed(folder, result) if isinstance(result, Exception) else result


def finished(
    case: Case | Path, folder: Path, reference: Mapping[str, str] | None = None
) -> dict[str, Any] | None:
    """The diagnosis in a folder, if it is complete and made from this case as it is now, by this program.

    Against a reference, by the hashes of what that was made from, it has to be made from that very one.
    """
    try:
        content = json.loads((folder / DOCUMENT).read_text(encoding="utf-8"))
        validate(content)
        complete = all((folder / name).is_file() for name in (CORRECTED, REPORT))
        # without a reference both are None
        compared_alike = content.get("against", {}).get(KEY) == reference
        unchanged = compared_alike and content.get(KEY) == made_from(case)
    except (OSError, ValueError, GapscopeError):
        return None
    return content if complete and unchanged else None


def diagnose_missing(
    cases: Mapping[str, Case | Path],
    out: Path,
    jobs: int,
    backend: str = LOCAL,
    against: Path | None = None,
    keep: Callable[[Case | Path, Path], dict[str, Any] | None] = finished,
) -> Iterator[tuple[Row, bool]]:
    """The row of each case, in order, and whether its diagnosis is kept from an earlier run.

    Args:
        cases: by the name of the folder of their results.
        out: in which these folders are.
        jobs: cases at a time.
        backend: ``local`` or ``ray``.
        against: reference of all cases.
        keep: the diagnosis of a case in its folder, if that need not be made again.
    """
    kept = {}
    for name, case in cases.items():
        found = keep(case, out / name)
        if found is not None:
            kept[name] = Row(str(found["case"]), name, found)
    calls = [
        (cases[name], out, name, against, ()) for name in cases if name not in kept
    ]
    # results come in the order in which they were asked, kept ones between them
    made = diagnose_calls(calls, jobs, backend)
    for name in cases:
        yield (kept[name], True) if name in kept else (next(made), False)


def diagnose_all(batch: Batch, progress: Callable[[str], None]) -> int:
    """Diagnose cases and write ``units.json`` and ``summary.html``; a case that fails does not stop the others.

    A case whose ``diagnosis.json`` is whole and made from the same files by the same program is kept.

    Returns:
        The exit code: 0, or the largest of the cases that failed.

    Raises:
        InputError: unknown backend.
        GapscopeError: Ray is not installed, ``out`` cannot be written, or the run was stopped.
    """
    check_backend(batch.backend)
    with locked(batch.out):
        # what speaks of all cases would be wrong from the first result on
        for name in (SUMMARY, UNITS):
            (batch.out / name).unlink(missing_ok=True)
        # left by a run that was stopped while it asked again
        for folder in batch.by_folder:
            shutil.rmtree(batch.out / (folder + AGAIN), ignore_errors=True)
        try:
            rows, code, content = _compared(batch, progress)
        except KeyboardInterrupt:
            raise InterruptedRunError(
                "interrupted before the last case was done",
                "run the same command again to resume: every case with a diagnosis.json is kept",
            ) from None
        if content["groups"]:
            write_json(content, batch.out / UNITS)
            console.print(fleet_tables(content))
        render_summary(rows, batch.out / SUMMARY, content)
        return code


def _compared(
    batch: Batch, progress: Callable[[str], None]
) -> tuple[list[Row], int, dict[str, Any]]:
    """The rows of all cases, the largest exit code, and the content of ``units.json``.

    Units go by the folders of their results, which occur once.
    """
    reference = None
    if batch.against is not None:
        against, known = kept_reference(batch.against, batch.out, progress)
        batch, reference = replace(batch, against=against), known.made_from
    rows = []
    cases, out, how = batch.by_folder, batch.out, (batch.jobs, batch.backend)

    def keep(case: Case | Path, folder: Path) -> dict[str, Any] | None:
        return None if batch.again else finished(case, folder, reference)

    for row, kept in diagnose_missing(cases, out, *how, batch.against, keep):
        rows.append(row)
        note = " (kept from an earlier run)" if kept else ""
        verdict = VERDICTS.get(row.verdict, "Failed")
        done = f"{len(rows)} of {len(batch.by_folder)} done"
        progress(f"{done}, {row.label}: {verdict.lower()}{note}")
        say(f"{row.label}: {row.line}{note}")
    code = max((row.exit_code for row in rows), default=0)
    rows = _by_law_of_type(batch, rows, progress)
    documents = {row.folder: row.document for row in rows if row.document is not None}
    units = []
    for name in documents:
        # what was found against a reference corrects the identified arm
        identified = batch.out / name / CASE
        case = batch.by_folder[name] if batch.against is None else identified
        corrected = batch.out / name / CORRECTED
        units.append(FleetUnit(name, case.resolve(), corrected.resolve()))
    groups, alone = grouped(documents, units)
    if groups:
        progress("compares the units")
    # a column is all arms of a group on one unit's recordings: those are read once
    calls = [(unit, group.units) for group in groups for unit in group.units]
    results = in_order(confusion_column, calls, batch.jobs, batch.backend)
    # a unit whose column fails is left out of the table, with the reason
    columns = {
        unit.name: ConfusionColumn(unit.name, {}, str(result))
        if isinstance(result, Exception)
        else result
        for (unit, _), result in zip(calls, results, strict=True)
    }
    confused = [(group, [columns[u.name] for u in group.units]) for group in groups]
    asked = [(group.units,) for group in groups]
    own: list[list[dict[str, Any]] | None] = []
    for result in in_order(unit_differences, asked, batch.jobs, batch.backend):
        # the diagnoses are worth something without it
        if isinstance(result, Exception):
            say(f"the recordings of the units are not compared: {result}")
        own.append(None if isinstance(result, Exception) else result)
    return rows, code, units_document(confused, alone, own)


def _by_law_of_type(
    batch: Batch, rows: Sequence[Row], progress: Callable[[str], None]
) -> list[Row]:
    """The rows, units with the friction law of their type where that explains as much as their own.

    Against a reference that is itself such a unit all have its friction already.
    """
    documents = {row.folder: row.document for row in rows if row.document is not None}
    # other laws are told by the diagnoses of all units, so that this comes last
    asked = {} if batch.against is not None else other_laws(documents)
    if not asked:
        return list(rows)
    progress(f"asks {', '.join(asked)} for the friction law of the type")
    found = {}
    calls = [
        (batch.by_folder[unit], batch.out, unit + AGAIN, None, left_out)
        for unit, left_out in asked.items()
    ]
    results = diagnose_calls(calls, batch.jobs, batch.backend)
    for unit, row in zip(asked, results, strict=True):
        again = batch.out / (unit + AGAIN)
        document = row.document
        if document is not None and explains_as_much(document, documents[unit]):
            # move results into the place of others; until the last file is there, the folder holds no diagnosis
            target = batch.out / unit
            (target / DOCUMENT).unlink()
            for path in sorted(again.iterdir(), key=lambda path: path.name == DOCUMENT):
                path.replace(target / path.name)
            found[unit] = replace(row, folder=unit)
            say(f"{unit}: with the friction law of its type, {found[unit].line}")
        shutil.rmtree(again, ignore_errors=True)
    return [found.get(row.folder, row) for row in rows]


def diagnose_one_of_many(
    path: Case | Path,
    out: Path,
    folder: str,
    against: Path | None,
    left_out: Sequence[str],
) -> Row:
    """Diagnose a case, or the one at a path, as one of several: its row of the summary.

    Args:
        path: the case, or where it is.
        out: folder of all results.
        folder: name of that of this case.
        against: the reference, or ``None``.
        left_out: names of effects that it is diagnosed without.
    """
    try:
        # of this case alone: the catalogue is whole again afterwards
        with without(left_out):
            result, _ = diagnose_path(path, out / folder, against=against)
    except Exception as error:
        # a fault of the program in one case does not stop the others either
        return _failed(folder, error)
    return Row(str(result.document["case"]), folder, result.document)


def _failed(folder: str, error: Exception) -> Row:
    """The row of a case that could not be diagnosed."""
    ours = isinstance(error, GapscopeError)
    problem = str(error) if ours else f"{type(error).__name__}: {error}"
    return Row(
        folder, folder, problem=problem, exit_code=getattr(error, "exit_code", 1)
    )
