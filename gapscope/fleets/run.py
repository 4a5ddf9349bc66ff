"""A run over a fleet: every case that has not been diagnosed yet, a few at a time, and its rows into the store."""

from __future__ import annotations

import hashlib
import math
import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pyarrow import compute as pc

from gapscope.archive.entry import CASE, UNITS_BY
from gapscope.arm.errors import InputError, InterruptedRunError
from gapscope.arm.folder_lock import locked
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.fleets.addresses import is_process_only
from gapscope.fleets.case_list import all_cases
from gapscope.fleets.store import FleetStore
from gapscope.fleets.task import (
    JSON,
    KEEP,
    FleetResult,
    FleetTask,
    clear_scratch,
    diagnose_fleet_case,
    failed_row,
)
from gapscope.provenance import program
from gapscope.workers.as_completed import TRIES, Ended, as_completed
from gapscope.workers.backends import LOCAL, check_backend

DIAGNOSES = "diagnoses"
PAUSE = 1.0
"""Time between files of rows [s], so that no run leaves 100 000 files; a case is reported with its row. (budget)"""


@dataclass(frozen=True)
class FleetPlan:
    """Which cases are diagnosed, how, and where results go.

    Attributes:
        cases: addresses; see ``find_cases`` and ``read_list``.
        out: folder of the results.
        jobs: cases at a time; by default one, and on a cluster as many as it has cores.
        backend: ``local`` or ``ray``.
        again: whether to diagnose what has been diagnosed as well.
        keep: files of each diagnosis: ``nothing``, ``json`` (and ``corrected.yaml``) or ``report`` (all).
        units_by: what names the unit of a case: ``case`` or ``folder``.
        largest: bytes that a case may have.
        scratch: folder for the files of a case while it is diagnosed; the system's by default.
        tries: times that a case is begun, at most, if its workers die.
    """

    cases: tuple[str, ...]
    out: Path
    jobs: int | None = None
    backend: str = LOCAL
    again: bool = False
    keep: str = JSON
    units_by: str = CASE
    largest: int = 1 << 31
    scratch: Path | None = None
    tries: int = TRIES


@dataclass
class FleetCounts:
    """How many cases a run has diagnosed, failed in, or kept from an earlier run."""

    diagnosed: int = 0
    failed: int = 0
    kept: int = 0

    def __str__(self) -> str:
        return f"{self.diagnosed} diagnosed, {self.failed} failed, {self.kept} kept from an earlier run"


def run_fleet(plan: FleetPlan, progress: Callable[[str], None]) -> FleetCounts:
    """Diagnose cases and add their rows; a case that fails does not stop the others.

    Raises:
        InputError: an option or an address cannot be used.
        GapscopeError: another run writes to the folder, Ray is not installed, or the run was stopped.
    """
    _check(plan)
    with locked(plan.out):
        store = FleetStore(plan.out)
        counts = FleetCounts()
        writer = _Writer(store, plan, counts)
        # one run at a time has these results: what an earlier one has left, if it was killed, bears the same name
        run = hashlib.sha256(str(plan.out.resolve()).encode()).hexdigest()[:12]
        clear_scratch(plan.scratch, run)
        tasks = ((task,) for task in _tasks(plan, run, store, counts))
        calls = as_completed(
            diagnose_fleet_case, tasks, plan.jobs, plan.backend, plan.tries
        )
        progress("lists the cases")
        try:
            with closing(calls):
                for call in calls:
                    writer.add(call)
                    progress(str(counts))
        except KeyboardInterrupt:
            writer.flush()
            raise InterruptedRunError(
                f"interrupted: {counts}",
                "run the same command again to resume: what has been diagnosed is kept",
            ) from None
        finally:
            writer.flush()
            clear_scratch(plan.scratch, run)
        store.merge()
    return counts


def _check(plan: FleetPlan) -> None:
    check_backend(plan.backend)
    for option, value, known in (
        ("--keep", plan.keep, tuple(KEEP)),
        ("--units-by", plan.units_by, UNITS_BY),
    ):
        if value not in known:
            raise InputError(
                f"unknown word {value!r}", f"use {', '.join(known)}", where=option
            )
    in_process = plan.backend == LOCAL and plan.jobs in (None, 1)
    for address in plan.cases:
        if is_process_only(address) and not in_process:
            raise InputError(
                f"{address}: other processes do not see the memory of this one",
                "use --jobs 1, or write the cases to a folder",
            )


def _known(store: FleetStore) -> dict[str, frozenset[str]]:
    """Fingerprints and hashes of each case that this program has diagnosed, by its address."""
    if not (store.folder / "cases").is_dir():
        return {}
    ours = (pc.field("program_sha256") == program()) & (pc.field("error") == "")
    rows = store.cases(["case", "fingerprint", "case_sha256"], ours)
    found: dict[str, frozenset[str]] = {}
    for case, *hashes in rows.itertuples(index=False, name=None):
        found[case] = found.get(case, frozenset()) | {text for text in hashes if text}
    return found


def _tasks(
    plan: FleetPlan, run: str, store: FleetStore, counts: FleetCounts
) -> Iterator[FleetTask]:
    """A task for each case, once, unless its listing shows that it is unchanged since it was diagnosed."""
    known = {} if plan.again else _known(store)
    seen: set[str] = set()
    for case in all_cases(plan.cases):
        if case.address in seen:
            continue
        seen.add(case.address)
        hashes = known.get(case.address, frozenset())
        if case.fingerprint in hashes:
            counts.kept += 1
            continue
        yield FleetTask(
            case,
            hashes,
            program(),
            run,
            plan.keep,
            plan.units_by,
            plan.largest,
            plan.scratch,
        )


class _Writer:
    """Gathers what workers send and writes it, a batch at a time."""

    def __init__(self, store: FleetStore, plan: FleetPlan, counts: FleetCounts) -> None:
        self._counts = counts
        self._store, self._plan = store, plan
        self._cases: list[dict[str, Any]] = []
        self._effects: list[Mapping[str, Any]] = []
        self._last = -math.inf

    def add(self, call: Ended) -> None:
        """Take a call that has ended."""
        result = call.result or self._lost(call)
        if not result.row:
            self._counts.kept += 1
            return
        kept = _keep(result, self._plan.out)
        self._cases.append({**result.row, "tries": call.tries, "kept": kept})
        self._effects += result.effects
        if time.monotonic() - self._last >= PAUSE:
            self.flush()

    def flush(self) -> None:
        """Write the rows that have come since the last time, and count them."""
        if self._cases:
            self._store.append(self._cases, [dict(row) for row in self._effects])
        failed = sum(bool(row["error"]) for row in self._cases)
        self._counts.failed += failed
        self._counts.diagnosed += len(self._cases) - failed
        self._cases, self._effects = [], []
        self._last = time.monotonic()

    def _lost(self, call: Ended) -> FleetResult:
        (task,) = call.arguments
        error = f"no worker brought it to an end: {call.error}"
        return FleetResult(failed_row(task.case, self._plan.units_by, error))


def _keep(result: FleetResult, out: Path) -> str:
    """Write the files of a diagnosis; returns their folder relative to the results, empty without files."""
    if not result.files:
        return ""
    row = result.row
    folder = Path(
        DIAGNOSES,
        _file_name(row["robot"]),
        _file_name(row["unit"]),
        f"{row['date']}_r{row['result'][:10]}",
    )
    for name, content in result.files.items():
        with atomic_write(out / folder / name) as aside:
            aside.write_bytes(content)
    return folder.as_posix()


def _file_name(name: str) -> str:
    """A name as one of a folder on any system, never hidden and never above."""
    return re.sub(r"[^\w.-]", "_", name)[:80].lstrip(".") or "_"
