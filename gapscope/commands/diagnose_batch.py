"""Several cases in one run: one sub-folder each, a comparison of the units, and a summary."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from joblib.externals.loky.process_executor import TerminatedWorkerError
from rich.console import Console

from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.json_file import write_json
from gapscope.commands.diagnose import diagnose_one_of_many, make_folder
from gapscope.commands.gap import units_text
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.fleet.confusion import Column, Unit, column
from gapscope.diagnosis.fleet.fleet_json import grouped, units_document
from gapscope.provenance import KEY, made_from
from gapscope.reports.diagnosis.summary import SummaryRow, render_summary
from gapscope.workers import RAY, check_backend, in_order

SUMMARY, UNITS = "summary.html", "units.json"
BESIDE = ("corrected.yaml", "report.html")
"""Files that are written before ``diagnosis.json``."""


class InterruptedRunError(GapscopeError):
    """The run was stopped from outside."""

    exit_code = 130


@dataclass(frozen=True)
class Batch:
    """Several cases and where their results go.

    Attributes:
        cases: folders of cases, or case files.
        out: folder of the results.
        jobs: cases at a time.
        backend: ``local`` or ``ray``.
        again: whether to diagnose what has been diagnosed as well.
    """

    cases: tuple[Path, ...]
    out: Path
    jobs: int = 1
    backend: str = "local"
    again: bool = False


def kept(case: Path, folder: Path) -> dict[str, Any] | None:
    """The diagnosis in a folder, if it is whole and made from this case as it is now, by this program."""
    try:
        content = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
        validate(content)
        whole = all((folder / name).is_file() for name in BESIDE)
        return content if whole and content.get(KEY) == made_from(case) else None
    except (OSError, ValueError, GapscopeError):
        return None


def diagnose_all(
    batch: Batch, progress: Callable[[str], None], console: Console
) -> int:
    """Diagnose cases and write ``units.json`` and ``summary.html``; a case that fails does not stop the others.

    A case whose ``diagnosis.json`` is whole and made from the same files by the same program is kept.

    Returns:
        The exit code: 0, or the largest of the cases that failed.

    Raises:
        InputError: unknown backend.
        GapscopeError: Ray is not installed, ``out`` cannot be written, or the run was stopped.
    """
    check_backend(batch.backend)
    make_folder(batch.out)
    for name in (SUMMARY, UNITS):
        (batch.out / name).unlink(missing_ok=True)
    folders = _folders(batch.cases)
    rows: list[SummaryRow] = []
    codes = [0]
    with _going_on():
        for row, code, note in _diagnosed(batch, folders):
            rows.append(row)
            codes.append(code)
            progress(
                f"{len(rows)} of {len(folders)} done, {row.label}: {row.verdict.lower()}{note}"
            )
            console.print(
                f"{row.label}: {row.failure or _line(row)}{note}",
                highlight=False,
                markup=False,
                soft_wrap=True,
            )
        content = _compared(batch, rows, progress)
    if content["groups"]:
        write_json(content, batch.out / UNITS)
        console.print(units_text(content))
    render_summary(rows, batch.out / SUMMARY, content)
    return max(codes)


def _diagnosed(
    batch: Batch, folders: Sequence[str]
) -> Iterator[tuple[SummaryRow, int, str]]:
    """Row of the summary, exit code and a note of each case, in their order."""
    pairs = list(zip(batch.cases, folders, strict=True))
    known = (
        {}
        if batch.again
        else {folder: kept(case, batch.out / folder) for case, folder in pairs}
    )
    place = (
        Path.resolve if batch.backend == RAY else Path
    )  # other machines have another current folder
    todo = [
        (str(place(case)), place(batch.out), folder)
        for case, folder in pairs
        if known.get(folder) is None
    ]
    made = in_order(diagnose_one_of_many, todo, batch.jobs, batch.backend)
    for _, folder in pairs:
        document = known.get(folder)
        if document is not None:
            yield (
                SummaryRow(str(document["case"]), folder, document),
                0,
                " (kept from an earlier run)",
            )
            continue
        result = next(made)
        if isinstance(result, Exception):
            result = (
                SummaryRow(
                    folder, folder, failure=f"{type(result).__name__}: {result}"
                ),
                1,
            )
        yield *result, ""


def _compared(
    batch: Batch, rows: Sequence[SummaryRow], progress: Callable[[str], None]
) -> dict[str, Any]:
    """Content of ``units.json``; units go by the folders of their results, which occur once."""
    cases = {
        folder: case.resolve()
        for case, folder in zip(batch.cases, _folders(batch.cases), strict=True)
    }
    documents = {row.folder: row.document for row in rows if row.document is not None}
    units = [
        Unit(name, cases[name], (batch.out / name / "corrected.yaml").resolve())
        for name in documents
    ]
    groups, alone = grouped(documents, units)
    if groups:
        progress("compares the units")
    work = [(unit, group.units) for group in groups for unit in group.units]
    found: dict[str, Column] = {}
    for (unit, _), made in zip(
        work, in_order(column, work, batch.jobs, batch.backend), strict=True
    ):
        found[unit.name] = (
            Column(unit.name, {}, str(made)) if isinstance(made, Exception) else made
        )
    return units_document(
        [(g, [found[unit.name] for unit in g.units]) for g in groups], alone
    )


@contextmanager
def _going_on() -> Iterator[None]:
    """Say how to go on where the run stops before its end."""
    try:
        yield
    except KeyboardInterrupt:
        raise InterruptedRunError(
            "interrupted before the last case was done",
            "run the same command again to go on: every case with a diagnosis.json is kept",
        ) from None
    except TerminatedWorkerError:
        raise GapscopeError(
            "a process was ended from outside, perhaps for want of memory",
            "run the same command again, with fewer --jobs, to go on: every case with a diagnosis.json is kept",
        ) from None


def _line(row: SummaryRow) -> str:
    effects = "; ".join(f"{name}, {where}" for name, where in row.effects)
    return f"{row.verdict}. {effects}".strip()


def _folders(cases: Sequence[Path]) -> list[str]:
    """A name for the results of each case: that of its folder or file, numbered where it repeats."""
    names: list[str] = []
    for case in cases:
        path = case.resolve()
        name = path.parent.name if path.name == "case.yaml" else path.stem
        names.append(name if name not in names else f"{name}-{len(names) + 1}")
    return names
