"""Many diagnoses: one task each, run on this machine's cores or a cluster, and gone on with after a stop."""

from __future__ import annotations

import hashlib
import math
import re
import shutil
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from pyarrow import compute as pc

from gapscope.archive import CASE, UNITS_BY, date_in_names, unit_name
from gapscope.arm.case import load_case
from gapscope.arm.errors import (
    EngineWarning,
    GapscopeError,
    InputError,
    InterruptedRunError,
    ModelWarning,
)
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.locked_section import locked
from gapscope.fleets.cases import (
    CaseAddress,
    all_cases,
    fetch,
    is_process_only,
    list_case,
    open_address,
)
from gapscope.fleets.store import UNKNOWN, FleetStore, effect_rows, gap_columns
from gapscope.interface.diagnose import DiagnosisResult, diagnose
from gapscope.provenance import fingerprint, made_from, program
from gapscope.reports.diagnosis import CORRECTED, DOCUMENT, REPORT
from gapscope.workers import LOCAL, TRIES, Ended, as_completed, check_backend

# The diagnosis of one case of many, as a worker makes it.


NOTHING, JSON, ALL = "nothing", "json", "report"
KEEP = {NOTHING: (), JSON: (CORRECTED, DOCUMENT), ALL: (CORRECTED, REPORT, DOCUMENT)}
"""Files that are kept of a diagnosis, the document last."""


@dataclass(frozen=True)
class FleetTask:
    """A case to diagnose.

    Attributes:
        case: where it is.
        known: fingerprints and hashes of this case that have been diagnosed by this program.
        program: hash of the program that asks for it.
        run: name of the run's results: no two runs write to them at a time.
        plan: what is kept, what names the unit, how large the case may be, and where its files lie meanwhile.
    """

    case: CaseAddress
    known: frozenset[str]
    program: str
    run: str
    plan: FleetPlan


@dataclass(frozen=True)
class FleetResult:
    """What a worker sends back.

    Attributes:
        row: of the case; empty if it is unchanged since an earlier run.
        effects: rows of its effects.
        files: what is kept of the diagnosis, by name.
    """

    row: Mapping[str, Any] = field(default_factory=dict)
    effects: tuple[Mapping[str, Any], ...] = ()
    files: Mapping[str, bytes] = field(default_factory=dict)


def diagnose_fleet_case(task: FleetTask) -> FleetResult:
    """Fetch a case, diagnose it, remove it; a case that fails is a row with its error."""
    start, spent = time.perf_counter(), time.process_time()
    with warnings.catch_warnings():
        for category in (ModelWarning, EngineWarning):
            warnings.simplefilter("ignore", category)
        try:
            result = _in_scratch(task)
        except GapscopeError as error:
            result = FleetResult({"error": str(error)})
        except Exception as error:
            # a fault of the program or of a storage in one case does not stop the others
            result = FleetResult({"error": f"{type(error).__name__}: {error}"})
    if not result.row:
        return result
    row = {
        **failed_row(task.case, task.plan.units_by),
        **result.row,
        "seconds": time.perf_counter() - start,
        "processor_seconds": time.process_time() - spent,
    }
    common = ("result", "case", "unit", "robot", "date", "nominal_sha256")
    effects = tuple(
        {**{key: row.get(key) for key in common}, **effect} for effect in result.effects
    )
    return FleetResult(row, effects, result.files)


def failed_row(case: CaseAddress, units_by: str, error: str = "") -> dict[str, Any]:
    """The row of a case of which no more is known than where it is."""
    name = case.address.rstrip("/").rpartition("/")[2]
    now = datetime.now(timezone.utc)
    return {
        "result": hashlib.sha256(f"{case.address}\0{now}".encode()).hexdigest()[:16],
        "case": case.address,
        "name": name,
        "unit": case.unit or unit_name(name, _place(case), units_by),
        "robot": UNKNOWN,
        **_when(case, name, case.changed),
        "finished": now,
        "fingerprint": case.fingerprint,
        "program_sha256": program(),
        "effects": [],
        "error": error,
    }


def _in_scratch(task: FleetTask) -> FleetResult:
    """The diagnosis of a case in a folder of its own.

    The name is the same if the call is made again, so that what a lost worker left is removed then.
    """
    if program() != task.program:
        raise GapscopeError(
            "the worker has another version of Gapscope, its libraries, or effects of your own",
            "install the same versions on all machines",
        )
    key = hashlib.sha256(task.case.address.encode()).hexdigest()[:16]
    folder = _above(task.plan.scratch) / f"gapscope-fleet-{task.run}-{key}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(mode=0o700, parents=True)
    try:
        return _fetched(task, folder)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def clear_scratch(scratch: Path | None, run: str) -> None:
    """Remove what workers of this machine that were lost have left of a run."""
    for folder in _above(scratch).glob(f"gapscope-fleet-{run}-*"):
        shutil.rmtree(folder, ignore_errors=True)


def _above(scratch: Path | None) -> Path:
    return scratch or Path(tempfile.gettempdir())


def _fetched(task: FleetTask, folder: Path) -> FleetResult:
    system, place = open_address(task.case.address)
    listing = list_case(system, place)
    if listing.fingerprint in task.known:
        return FleetResult()
    case_folder = folder / "case"
    case_folder.mkdir()
    size = fetch(system, place, listing, case_folder, task.plan.largest)
    source = made_from(case_folder)
    if source["case_sha256"] in task.known:
        return FleetResult()
    case = load_case(case_folder, any_unit=True)
    found = diagnose(case)
    document = found.document
    changed = listing.changed if task.case.changed is None else task.case.changed
    row = {
        **gap_columns(document),
        **source,
        "name": document["case"],
        "robot": document["arm"]["robot"] if "arm" in document else case.arm.name,
        "joints": list(case.arm.joints),
        "unit": task.case.unit
        or unit_name(document["case"], _place(task.case), task.plan.units_by),
        **_when(task.case, document["case"], changed),
        "fingerprint": listing.fingerprint,
        "nominal_sha256": fingerprint(case.arm),
        "bytes": size,
    }
    return FleetResult(row, tuple(effect_rows(document)), _files(found, folder, task))


def _files(found: DiagnosisResult, folder: Path, task: FleetTask) -> dict[str, bytes]:
    """What is kept of a diagnosis."""
    names = KEEP[task.plan.keep]
    if not names:
        return {}
    out = folder / "diagnosis"
    found.save(out)
    return {name: (out / name).read_bytes() for name in names}


def _place(case: CaseAddress) -> str:
    """Folders of a case, from the outermost."""
    path = case.address.split("::")[0].rpartition("://")[2]
    return path.strip("/") or case.address


def _when(case: CaseAddress, name: str, changed: float | None) -> dict[str, Any]:
    """Time and day of a case: as listed, else in its name or those of its folders, else of its files' last change."""
    if case.date:
        time_of = datetime.fromisoformat(case.date)
    else:
        last = datetime.now() if changed is None else datetime.fromtimestamp(changed)
        time_of = date_in_names(name, _place(case)) or last
    return {"recorded_at": time_of, "date": f"{time_of:%Y-%m-%d}"}


# A run over a fleet: every case that has not been diagnosed yet, a few at a time, and its rows into the store.


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
        yield FleetTask(case, hashes, program(), run, plan)


class _Writer:
    """Gathers what workers send and writes it, a batch at a time."""

    def __init__(self, store: FleetStore, plan: FleetPlan, counts: FleetCounts) -> None:
        self._store, self._plan, self._counts = store, plan, counts
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
