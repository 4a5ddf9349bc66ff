"""Several cases in one run: one sub-folder each, a comparison of the units, and a summary."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from gapscope.arm.errors import GapscopeError, InterruptedRunError
from gapscope.arm.io.json_file import write_json
from gapscope.arm.io.locked_section import locked
from gapscope.commands.diagnose_path import diagnose_path
from gapscope.diagnosis.compare_units import (
    ConfusionColumn,
    FleetGroup,
    FleetUnit,
    confusion_column,
    explains_as_much,
    grouped,
    other_laws,
    units_document,
)
from gapscope.diagnosis.diagnose_change import FOLDER
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.effects.catalogue import without
from gapscope.interface.reference import kept_reference
from gapscope.provenance import KEY, made_from
from gapscope.reports.compared_units import fleet_tables
from gapscope.reports.diagnosis import (
    CASE,
    CORRECTED,
    DOCUMENT,
    REPORT,
    SummaryRow,
    render_summary,
)
from gapscope.terminal import console, say
from gapscope.workers import RAY, check_backend, in_order

SUMMARY, UNITS = "summary.html", "units.json"
AGAIN = ".of_type"
"""Ends the name of the folder of a unit that is asked again, until it takes the place of the first one."""


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
        found: dict[str, Path] = {}
        for case in self.cases:
            path = case.resolve()
            name = path.parent.name if path.name == "case.yaml" else path.stem
            taken = name in (*found, FOLDER)
            found[f"{name}-{len(found) + 1}" if taken else name] = case
        return found

    def diagnosed(
        self, folders: Mapping[str, str], left_out: Mapping[str, Sequence[str]]
    ) -> Iterator[tuple[SummaryRow, int] | Exception]:
        """Diagnose cases.

        Args:
            folders: of the results, by the name of the case.
            left_out: effects that a case is diagnosed without.
        """
        # with Ray, other machines have another current folder
        place = Path.resolve if self.backend == RAY else Path
        against = self.against and place(self.against)
        calls = [
            (str(place(self.by_folder[name])), place(self.out), folder, against, left_out.get(name, ()))
            for name, folder in folders.items()
        ]  # fmt: skip
        return in_order(diagnose_one_of_many, calls, self.jobs, self.backend)


def finished(
    case: Path, folder: Path, reference: Mapping[str, str] | None = None
) -> dict[str, Any] | None:
    """The diagnosis in a folder, if it is complete and made from this case as it is now, by this program.

    Against a reference, by the hashes of what that was made from, it has to be made from that very one.
    """
    try:
        content = json.loads((folder / DOCUMENT).read_text(encoding="utf-8"))
        validate(content)
        others = (folder / CORRECTED, folder / REPORT)
        complete = all(path.is_file() for path in others)
        source = content.get("against", {}).get(KEY)
        compared_alike = source == reference
        unchanged = compared_alike and content.get(KEY) == made_from(case)
    except (OSError, ValueError, GapscopeError):
        return None
    return content if complete and unchanged else None


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
        for name in (SUMMARY, UNITS):
            (batch.out / name).unlink(missing_ok=True)
        folders = batch.by_folder
        for folder in folders:
            shutil.rmtree(batch.out / (folder + AGAIN), ignore_errors=True)
        rows: list[SummaryRow] = []
        codes = [0]
        with _resume_hint():
            against, reference = batch.against, None
            if against is not None:
                against, kept = kept_reference(against, batch.out, progress)
                reference = kept.made_from
            for row, code, note in _diagnosed(
                replace(batch, against=against), reference
            ):
                rows.append(row)
                codes.append(code)
                progress(
                    f"{len(rows)} of {len(folders)} done, {row.label}: {row.verdict.lower()}{note}"
                )
                say(f"{row.label}: {row.failure or _line(row)}{note}")
            rows = _by_law_of_type(batch, rows, progress)
            content = _compared(batch, rows, progress)
        if content["groups"]:
            write_json(content, batch.out / UNITS)
            console.print(fleet_tables(content))
        render_summary(rows, batch.out / SUMMARY, content)
        return max(codes)


def _diagnosed(
    batch: Batch, reference: Mapping[str, str] | None
) -> Iterator[tuple[SummaryRow, int, str]]:
    """Row of the summary, exit code and a note of each case, in their order; against a folder of its reference."""
    kept = {}
    for folder, case in batch.by_folder.items():
        document = None
        if not batch.again:
            document = finished(case, batch.out / folder, reference)
        if document is not None:
            kept[folder] = document
    asked = {folder: folder for folder in batch.by_folder if folder not in kept}
    results = batch.diagnosed(asked, {})
    for folder in batch.by_folder:
        if folder in kept:
            document = kept[folder]
            row = SummaryRow(str(document["case"]), folder, document)
            yield row, 0, " (kept from an earlier run)"
            continue
        result = next(results)
        if isinstance(result, Exception):
            yield _failed(folder, result), 1, ""
        else:
            yield *result, ""


def _by_law_of_type(
    batch: Batch, rows: Sequence[SummaryRow], progress: Callable[[str], None]
) -> list[SummaryRow]:
    """The rows, units with the friction law of their type where that explains as much as their own.

    Against a reference that is itself such a unit all have its friction already.
    """
    documents = {row.folder: row.document for row in rows if row.document is not None}
    asked = {} if batch.against is not None else other_laws(documents)
    if not asked:
        return list(rows)
    progress(f"asks {', '.join(asked)} for the friction law of the type")
    results = batch.diagnosed({unit: unit + AGAIN for unit in asked}, asked)
    found = {}
    for unit, result in zip(asked, results, strict=True):
        row = None if isinstance(result, Exception) else result[0]
        document = None if row is None else row.document
        again = batch.out / (unit + AGAIN)
        if document is not None and explains_as_much(document, documents[unit]):
            # move results into the place of others; until the last file is there, the folder holds no diagnosis
            target = batch.out / unit
            (target / DOCUMENT).unlink()
            files = sorted(again.iterdir(), key=lambda path: path.name == DOCUMENT)
            for path in files:
                path.replace(target / path.name)
            found[unit] = SummaryRow(str(document["case"]), unit, document)
            say(f"{unit}: with the friction law of its type, {_line(found[unit])}")
        shutil.rmtree(again, ignore_errors=True)
    return [found.get(row.folder, row) for row in rows]


def diagnose_one_of_many(
    path: str,
    out: Path,
    folder: str,
    against: Path | None = None,
    left_out: Sequence[str] = (),
) -> tuple[SummaryRow, int]:
    """Diagnose the case at a path as one of several: its row of the summary, and its exit code.

    Args:
        path: of the case.
        out: folder of all results.
        folder: name of that of this case.
        against: the reference, or ``None``.
        left_out: names of effects that it is diagnosed without.
    """
    try:
        with without(left_out):
            result, _ = diagnose_path(Path(path), out / folder, against=against)
    except GapscopeError as error:
        return SummaryRow(folder, folder, failure=str(error)), error.exit_code
    except Exception as error:
        # a fault of the program in one case does not stop the others either
        return _failed(folder, error), 1
    document = result.document
    return SummaryRow(str(document["case"]), folder, document), 0


def _failed(folder: str, error: Exception) -> SummaryRow:
    return SummaryRow(folder, folder, failure=f"{type(error).__name__}: {error}")


def _compared(
    batch: Batch, rows: Sequence[SummaryRow], progress: Callable[[str], None]
) -> dict[str, Any]:
    """Content of ``units.json``; units go by the folders of their results, which occur once."""
    cases = batch.by_folder
    documents = {row.folder: row.document for row in rows if row.document is not None}
    if batch.against is not None:
        # what was found corrects the identified arm
        cases = {name: batch.out / name / CASE for name in documents}
    units = [
        FleetUnit(name, cases[name].resolve(), (batch.out / name / CORRECTED).resolve())
        for name in documents
    ]
    groups, alone = grouped(documents, units)
    if groups:
        progress("compares the units")
    columns = _columns(batch, groups)
    with_columns = [
        (group, [columns[unit.name] for unit in group.units]) for group in groups
    ]
    return units_document(with_columns, alone)


def _columns(batch: Batch, groups: Sequence[FleetGroup]) -> dict[str, ConfusionColumn]:
    """Column of the confusion of each unit: all arms of its group on its recordings."""
    calls = [(unit, group.units) for group in groups for unit in group.units]
    results = in_order(confusion_column, calls, batch.jobs, batch.backend)
    columns: dict[str, ConfusionColumn] = {}
    for (unit, _), result in zip(calls, results, strict=True):
        if isinstance(result, Exception):
            # a unit whose column fails is left out of the table, with the reason
            result = ConfusionColumn(unit.name, {}, str(result))
        columns[unit.name] = result
    return columns


@contextmanager
def _resume_hint() -> Iterator[None]:
    """Say how to resume if the run stops before its end."""
    try:
        yield
    except KeyboardInterrupt:
        raise InterruptedRunError(
            "interrupted before the last case was done",
            "run the same command again to resume: every case with a diagnosis.json is kept",
        ) from None


def _line(row: SummaryRow) -> str:
    effects = "; ".join(f"{name}, {where}" for name, where in row.named())
    return f"{row.verdict}. {effects}".strip()
