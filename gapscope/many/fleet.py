"""Diagnose a fleet: many cases at any address, each once, and their rows kept, gone on with after a stop."""

from __future__ import annotations

import hashlib
import math
import re
import shutil
import tempfile
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from operator import itemgetter
from pathlib import Path
from typing import Any

import pandas as pd
from pyarrow import compute as pc

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
from gapscope.arm.nearest_name import check_known
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.interface.diagnose import diagnose
from gapscope.interface.result import DocumentResult
from gapscope.many.cases import (
    CaseAddress,
    all_cases,
    fetch,
    is_process_only,
    list_case,
    open_address,
    stamps,
)
from gapscope.many.compare import fleet_document
from gapscope.many.pages import render_fleet, summary
from gapscope.many.rows import (
    CASE,
    UNITS_BY,
    UNKNOWN,
    FleetStore,
    Row,
    date_in_names,
    unit_name,
)
from gapscope.many.workers import LOCAL, TRIES, Ended, as_completed, check_backend
from gapscope.provenance import fingerprint, made_from, program
from gapscope.reports.diagnosis import CORRECTED, REPORT
from gapscope.reports.diagnosis import DOCUMENT as DIAGNOSIS

DOCUMENT, PAGE = "fleet.json", "fleet.html"
NOTHING, JSON, ALL = "nothing", "json", "report"
KEEP = {NOTHING: (), JSON: (CORRECTED, DIAGNOSIS), ALL: (CORRECTED, REPORT, DIAGNOSIS)}
"""Files that are kept of a diagnosis, the document last."""
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

    @property
    def run(self) -> str:
        """Name of the run's results: one run at a time has them, and one after a killed one the same."""
        return hashlib.sha256(str(self.out.resolve()).encode()).hexdigest()[:12]

    def place(self, key: str) -> Path:
        """The folder of a case while it is diagnosed; of all cases of this run for ``*``."""
        above = self.scratch or Path(tempfile.gettempdir())
        return above / f"gapscope-fleet-{self.run}-{key}"

    def check(self) -> None:
        """Check all options before any work.

        Raises:
            InputError: an option or an address cannot be used.
            GapscopeError: Ray is not installed.
        """
        check_backend(self.backend)
        check_known("files to keep", self.keep, KEEP, where="--keep")
        check_known("name of units", self.units_by, UNITS_BY, where="--units-by")
        in_process = self.backend == LOCAL and self.jobs in (None, 1)
        for address in self.cases:
            if is_process_only(address) and not in_process:
                raise InputError(
                    f"{address}: other processes do not see the memory of this one",
                    "use --jobs 1, or write the cases to a folder",
                )

    def clear_scratch(self) -> None:
        """Remove what workers of this machine that were lost have left."""
        every = self.place("*")
        for folder in every.parent.glob(every.name):
            shutil.rmtree(folder, ignore_errors=True)


# The diagnosis of one case of many, as a worker makes it.


Made = tuple[dict[str, Any], list[dict[str, Any]], dict[str, bytes]]
"""Row of a case, which is empty if it is unchanged; rows of its effects; and the files that are kept, by name."""


def diagnose_fleet_case(
    case: CaseAddress, known: frozenset[str], made_by: str, plan: FleetPlan
) -> Made:
    """Fetch a case, diagnose it, remove it; a case that fails is a row with its error.

    Args:
        case: where it is.
        known: fingerprints and hashes of this case that have been diagnosed by this program.
        made_by: hash of the program that asks for it.
        plan: what is kept, what names the unit, how large the case may be, and where its files lie meanwhile.
    """
    # time that passes, and time that this process computes
    start, spent = time.perf_counter(), time.process_time()
    # the name is the same if the call is made again, so that what a lost worker left is removed then
    folder = plan.place(hashlib.sha256(case.address.encode()).hexdigest()[:16])
    row: dict[str, Any] = {}
    effects: list[dict[str, Any]] = []
    files: dict[str, bytes] = {}
    with warnings.catch_warnings():
        for category in (ModelWarning, EngineWarning):
            warnings.simplefilter("ignore", category)
        try:
            # before any work: rows of two programs do not compare
            if program() != made_by:
                raise GapscopeError(
                    "the worker has another version of Gapscope, its libraries, or effects of your own",
                    "install the same versions on all machines",
                )
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(mode=0o700, parents=True)
            row, effects, files = _fetched(case, known, plan, folder)
        except Exception as error:
            # a fault of the program or of a storage in one case does not stop the others
            ours = isinstance(error, GapscopeError)
            said = str(error) if ours else f"{type(error).__name__}: {error}"
            row = {"error": said}
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    # unchanged: there is nothing to add
    if not row:
        return row, effects, files
    # what is known of any case, overwritten by what this one has shown
    row = {
        **failed_row(case, plan.units_by),
        **row,
        "seconds": time.perf_counter() - start,
        "processor_seconds": time.process_time() - spent,
    }
    common = ("result", "case", "unit", "robot", "date", "nominal_sha256")
    of_case = {key: row.get(key) for key in common}
    return row, [{**of_case, **effect} for effect in effects], files


def failed_row(case: CaseAddress, units_by: str, error: str = "") -> dict[str, Any]:
    """The row of a case of which no more is known than where it is."""
    name = case.address.rstrip("/").rpartition("/")[2]
    now = datetime.now(timezone.utc)
    return {
        # a case that fails again is another row
        "result": hashlib.sha256(f"{case.address}\0{now}".encode()).hexdigest()[:16],
        "case": case.address,
        "robot": UNKNOWN,
        **_named(case, name, units_by, case.changed),
        "finished": now,
        "fingerprint": case.fingerprint,
        "program_sha256": program(),
        "effects": [],
        "error": error,
    }


def _named(
    case: CaseAddress, name: str, units_by: str, changed: float | None
) -> dict[str, Any]:
    """Name, unit, time and day of a case: as listed, else by its names or folders, else of its files' last change."""
    # in an archive the path within it
    path = case.address.split("::")[0].rpartition("://")[2]
    folders = path.strip("/") or case.address
    if case.date:
        when = datetime.fromisoformat(case.date)
    else:
        last = datetime.now() if changed is None else datetime.fromtimestamp(changed)
        when = date_in_names(name, folders) or last
    unit = case.unit or unit_name(name, folders, units_by)
    day = f"{when:%Y-%m-%d}"
    return {"name": name, "unit": unit, "recorded_at": when, "date": day}


def _fetched(
    case: CaseAddress, known: frozenset[str], plan: FleetPlan, folder: Path
) -> Made:
    """The diagnosis of a case that is fetched into a folder, unless that shows that it is known."""
    system, place = open_address(case.address)
    files = list_case(system, place)
    stamp, changed = stamps(files)
    # stamps of the storage spare the fetch
    if stamp in known:
        return {}, [], {}
    here, out = folder / "case", folder / "diagnosis"
    here.mkdir()
    size = fetch(system, place, files, here, plan.largest)
    source = made_from(here)
    # new stamps on the same content: the diagnosis would be the same
    if source["case_sha256"] in known:
        return {}, [], {}
    # units may be wrong: the diagnosis itself finds that
    loaded = load_case(here, any_unit=True)
    found = diagnose(loaded)
    document = found.document
    if case.changed is not None:
        changed = case.changed
    diagnosed = Row(document["case"], place, document)
    row = {
        **diagnosed.columns(),
        **source,
        "robot": document["arm"]["robot"] if "arm" in document else loaded.arm.name,
        "joints": list(loaded.arm.joints),
        **_named(case, document["case"], plan.units_by, changed),
        "fingerprint": stamp,
        "nominal_sha256": fingerprint(loaded.arm),
        "bytes": size,
    }
    names = KEEP[plan.keep]
    if names:
        found.save(out)
    # as bytes: the folder lies on the worker, and is removed there
    kept = {name: (out / name).read_bytes() for name in names}
    return row, list(diagnosed.numbers()), kept


# A run over a fleet: every case that has not been diagnosed yet, a few at a time, and its rows into the store.


@dataclass
class FleetCounts:
    """How many cases a run has diagnosed, failed in, or kept from an earlier run."""

    diagnosed: int = 0
    failed: int = 0
    kept: int = 0

    def __str__(self) -> str:
        return f"{self.diagnosed} diagnosed, {self.failed} failed, {self.kept} kept from an earlier run"


def run_fleet(plan: FleetPlan, progress: Progress) -> FleetCounts:
    """Diagnose cases and add their rows; a case that fails does not stop the others.

    Raises:
        InputError: an option or an address cannot be used.
        GapscopeError: another run writes to the folder, Ray is not installed, or the run was stopped.
    """
    plan.check()
    # a worker of this machine has a temporary folder of its own: cases lie where the next run finds what is left
    if plan.backend == LOCAL and plan.scratch is None:
        plan = replace(plan, scratch=Path(tempfile.gettempdir()))
    with locked(plan.out):
        store, counts = FleetStore(plan.out), FleetCounts()
        cases: list[dict[str, Any]] = []
        effects: list[dict[str, Any]] = []
        last = -math.inf

        def write() -> None:
            """Write the rows that have come since the last time, and count them when they are on disk."""
            if cases:
                store.append(cases, effects)
            failed = sum(bool(row["error"]) for row in cases)
            counts.failed += failed
            counts.diagnosed += len(cases) - failed
            cases.clear()
            effects.clear()

        # of a run that was killed
        plan.clear_scratch()
        tasks = _tasks(plan, store, counts)
        calls = as_completed(
            diagnose_fleet_case, tasks, plan.jobs, plan.backend, plan.tries
        )
        progress("lists the cases")
        try:
            # workers end with the loop, however it ends
            with closing(calls):
                for call in calls:
                    row, own, files = call.result or _lost(call, plan)
                    if row:
                        kept = _keep(row, files, plan.out)
                        cases.append({**row, "tries": call.tries, "kept": kept})
                        effects += own
                    else:
                        counts.kept += 1
                    if time.monotonic() - last >= PAUSE:
                        write()
                        last = time.monotonic()
                    progress(str(counts))
        except KeyboardInterrupt:
            # before it is said how many are done
            write()
            raise InterruptedRunError(
                f"interrupted: {counts}",
                "run the same command again to resume: what has been diagnosed is kept",
            ) from None
        finally:
            write()
            plan.clear_scratch()
        # a file for each second of the run becomes one for each robot and day
        for folder in store.merge():
            # what was written there, and no more: a person may have added to it
            for name in KEEP[ALL]:
                (plan.out / folder / name).unlink(missing_ok=True)
            with suppress(OSError):
                (plan.out / folder).rmdir()
    return counts


def _lost(call: Ended, plan: FleetPlan) -> Made:
    """What is known of a case whose worker died each time."""
    error = f"no worker brought it to an end: {call.error}"
    return failed_row(call.arguments[0], plan.units_by, error), [], {}


def _known(store: FleetStore) -> dict[str, frozenset[str]]:
    """Fingerprints and hashes of each case that this program has diagnosed, by its address."""
    if not (store.folder / "cases").is_dir():
        return {}
    # of another program, or failed: asked once more
    ours = (pc.field("program_sha256") == program()) & (pc.field("error") == "")
    rows = store.cases(["case", "fingerprint", "case_sha256"], ours)
    found: dict[str, frozenset[str]] = {}
    for case, *hashes in rows.itertuples(index=False, name=None):
        found[case] = found.get(case, frozenset()) | {text for text in hashes if text}
    return found


def _tasks(
    plan: FleetPlan, store: FleetStore, counts: FleetCounts
) -> Iterator[tuple[Any, ...]]:
    """Arguments for each case, once, unless its listing shows that it is unchanged since it was diagnosed."""
    known = {} if plan.again else _known(store)
    seen = set()
    for case in all_cases(plan.cases):
        if case.address in seen:
            continue
        seen.add(case.address)
        hashes = known.get(case.address, frozenset())
        # an empty one, which is not known, is never among them
        if case.fingerprint in hashes:
            counts.kept += 1
        else:
            yield case, hashes, program(), plan


def _keep(row: Mapping[str, Any], files: Mapping[str, bytes], out: Path) -> str:
    """Write the files of a diagnosis; returns their folder relative to the results, empty without files."""
    if not files:
        return ""
    # names as those of folders on any system, never hidden and never above
    robot, unit = (
        re.sub(r"[^\w.-]", "_", row[key])[:80].lstrip(".") or "_"
        for key in ("robot", "unit")
    )
    folder = Path(DIAGNOSES, robot, unit, f"{row['date']}_r{row['result'][:10]}")
    for name, content in files.items():
        with atomic_write(out / folder / name) as aside:
            aside.write_bytes(content)
    return folder.as_posix()


# The run, and what all rows say together.


@dataclass(frozen=True, repr=False, kw_only=True)
class FleetOverview(DocumentResult):
    """The diagnoses of a fleet, compared; links of the page lead to diagnoses only in the folder of the run.

    Attributes:
        store: all rows, as Parquet.
        counts: what this run did.
    """

    store: FleetStore
    counts: FleetCounts

    def to_frame(self) -> pd.DataFrame:
        """A row for each case: verdict, gap, effects, seconds, error; ``store.effects`` has the numbers."""
        return self.store.cases()


def fleet(
    cases: str | Path | Sequence[str | Path],
    out: str | Path,
    *,
    progress: Progress = silent,
    **options: Any,
) -> FleetOverview:
    """Diagnose all cases that have not been diagnosed yet, and compare units and dates.

    Args:
        cases: addresses of cases, of folders or archives of them, or of lists; paths, or URLs that fsspec knows.
        out: folder of the results, which later runs add to.
        progress: called with a few words at each step.
        **options: ``jobs``, ``backend``, ``again``, ``keep``, ``units_by``, ``largest``, ``scratch``, ``tries`` of
            ``gapscope.many.fleet.FleetPlan``.

    Raises:
        InputError: an option or an address cannot be used.
        GapscopeError: another run writes to ``out``, or the run was stopped.

    Examples:
        >>> import gapscope
        >>> overview = gapscope.fleet("s3://robots/cases", "fleet", jobs=8)  # doctest: +SKIP
        >>> overview.document["changes"]  # doctest: +SKIP
    """
    several = [cases] if isinstance(cases, (str, Path)) else cases
    plan = FleetPlan(tuple(str(case) for case in several), Path(out), **options)
    counts = run_fleet(plan, progress)
    progress("compares units and dates")
    store = FleetStore(plan.out)
    overview = FleetOverview(
        name="fleet",
        document=fleet_document(store),
        text=summary,
        rows=itemgetter("worst"),
        page=render_fleet,
        store=store,
        counts=counts,
    )
    overview.save(plan.out)
    return overview
