"""The diagnosis of one case of many, as a worker makes it."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from gapscope.archive.entry import CASE, date_in_names, unit_name
from gapscope.arm.case import load_case
from gapscope.arm.errors import EngineWarning, GapscopeError, ModelWarning
from gapscope.fleets.addresses import CaseAddress, list_case, open_address
from gapscope.fleets.fetch import fetch
from gapscope.fleets.rows import UNKNOWN, effect_rows, gap_columns
from gapscope.interface.diagnose import DiagnosisResult, diagnose
from gapscope.outputs.diagnosis import CORRECTED, DOCUMENT, REPORT
from gapscope.provenance import fingerprint, made_from, program

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
        keep: ``nothing``, ``json`` or ``report``.
        units_by: what names the unit: ``case`` or ``folder``.
        largest: bytes that the case may have.
        scratch: folder for the files of the case while it is diagnosed; the system's by default.
    """

    case: CaseAddress
    known: frozenset[str]
    program: str
    run: str
    keep: str = JSON
    units_by: str = CASE
    largest: int = 1 << 31
    scratch: Path | None = None


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
        **failed_row(task.case, task.units_by),
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
    folder = _above(task.scratch) / f"gapscope-fleet-{task.run}-{key}"
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
    size = fetch(system, place, listing, case_folder, task.largest)
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
        or unit_name(document["case"], _place(task.case), task.units_by),
        **_when(task.case, document["case"], changed),
        "fingerprint": listing.fingerprint,
        "nominal_sha256": fingerprint(case.arm),
        "bytes": size,
    }
    return FleetResult(row, tuple(effect_rows(document)), _files(found, folder, task))


def _files(found: DiagnosisResult, folder: Path, task: FleetTask) -> dict[str, bytes]:
    """What is kept of a diagnosis."""
    names = KEEP[task.keep]
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
