"""What a fleet costs: measured per case, per recorded hour and for the driver, and carried to 100 000 robots.

    .venv/bin/python experiments/45_fleet_cost.py --cases 1000 [--jobs 2] [--backend ray] [--out out/fleet_cost]

Four parts, of which ``--parts`` chooses: ``cost`` diagnoses short simulated cases of a KUKA iiwa with seeds and effects
drawn for each (their effects are those of the catalogue: this measures time and bytes, not accuracy); ``driver`` runs
over empty cases, which fail at once, so that what is left is the driver; ``compare`` compares a store of many units;
``alarms`` counts false alarms of change points on simulated histories. Time is processor time. Each part adds to
``figures.json``; at its end the script prints the tables of ``docs/fleet.md`` from it.
A run that is interrupted goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from fleet_cases import make_cases
from fleet_histories import alarms_of_a_fleet, fill_store, level_of_one_history

from gapscope.arm.io.json_file import write_json
from gapscope.fleets.fleet_json import fleet_document
from gapscope.fleets.run import FleetPlan, run_fleet
from gapscope.fleets.store import FleetStore

Figures = dict[str, Any]
DAYS = 10
"""Days of each simulated unit [1]."""
EMPTY = (1000, 5000)
"""Empty cases of the part ``driver`` [1]."""
STORED = (500, 3000)
"""Units of the stores of the part ``compare`` [1]."""


def peak_memory() -> float:
    """Largest memory of this process so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def size_of(folder: Path) -> int:
    """Bytes of the files of a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def cost(options: argparse.Namespace) -> Figures:
    """Diagnose the cases; processor time grows with the length of a case as a + b length."""
    folder, out = options.out / "cases", options.out / "results"
    if not folder.is_dir():
        make_cases(folder, -(-options.cases // DAYS), DAYS, seed=45)
    before = peak_memory()
    plan = FleetPlan((str(folder),), out, options.jobs, options.backend)
    run_fleet(plan, print)
    store = FleetStore(out)
    rows = store.cases()
    done = rows[rows["error"] == ""]
    lengths = np.vander(done["recorded_seconds"], 2)
    slope, fixed = np.linalg.lstsq(lengths, done["processor_seconds"], rcond=None)[0]
    count, hours = len(done), done["recorded_seconds"].sum() / 3600
    return {
        "cases": count,
        "failed": int((rows["error"] != "").sum()),
        "recorded_hours": hours,
        "processor_seconds_per_case": float(done["processor_seconds"].mean()),
        "processor_seconds_fixed": float(fixed),
        "processor_seconds_per_second": float(slope),
        "processor_hours_per_robot_hour": float(
            done["processor_seconds"].sum() / 3600 / hours
        ),
        "input_bytes_per_hour": float(done["bytes"].sum() / hours),
        "parquet_bytes_per_case": (size_of(out / "cases") + size_of(out / "effects"))
        / count,
        "kept_bytes_per_case": size_of(out / "diagnoses") / count,
        "driver_memory_mb": peak_memory(),
        "driver_memory_before_mb": before,
        "driver_is_worker": options.backend == "local" and options.jobs in (None, 1),
        "jobs": options.jobs,
        "backend": options.backend,
    }


def driver(options: argparse.Namespace) -> Figures:
    """The driver alone: cases that fail at once, listed, run in its process, and written; slopes between two counts."""
    small, large = (fresh(_empty_run, options.out, count) for count in EMPTY)
    more = EMPTY[1] - EMPTY[0]
    return {
        "cases": EMPTY,
        "processor_seconds_per_case": (large["seconds"] - small["seconds"]) / more,
        "memory_bytes_per_case": (large["memory"] - small["memory"]) * 2**20 / more,
        "memory_mb": large["memory"],
    }


def _empty_run(out: Path, count: int) -> Figures:
    folder = out / f"empty_{count}"
    for number in range(count):
        place = folder / f"unit{number:05d}" / "2026-01-01"
        place.mkdir(parents=True, exist_ok=True)
        (place / "case.yaml").write_text("name: x\n")
        for name in ("robot.urdf", "0.csv", "1.csv"):
            (place / name).touch()
    plan = FleetPlan((str(folder),), out / f"empty_results_{count}", again=True)
    start = time.process_time()
    run_fleet(plan, lambda message: None)
    return {"seconds": time.process_time() - start, "memory": peak_memory()}


def compare(options: argparse.Namespace) -> Figures:
    """Units and dates compared, for stores of two sizes; slopes between them."""
    found = []
    for units in STORED:
        folder = options.out / f"store_{units}"
        if not folder.is_dir():
            fresh(fill_store, folder, units, DAYS, units)
        found.append({**fresh(_compared, folder), "bytes": size_of(folder)})
    small, large = found
    more = (STORED[1] - STORED[0]) * DAYS
    return {
        "cases": [units * DAYS for units in STORED],
        "processor_seconds_per_case": (large["seconds"] - small["seconds"]) / more,
        "memory_bytes_per_case": (large["memory"] - small["memory"]) * 2**20 / more,
        "parquet_bytes_per_case": (large["bytes"] - small["bytes"]) / more,
    }


def _compared(folder: Path) -> Figures:
    start = time.process_time()
    fleet_document(FleetStore(folder))
    return {"seconds": time.process_time() - start, "memory": peak_memory()}


def fresh(function: Callable[..., Any], *arguments: Any) -> Any:
    """Result of a call in a new process, of which the peak memory is its own."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(function, *arguments).result()


def alarms(options: argparse.Namespace) -> Figures:
    """False alarms of single histories at 1 %, and of fleets at their 5 %."""
    rng = np.random.default_rng(45)
    fleets = []
    for n, step, wide in ((6, 0, 1), (12, 0, 2), (12, 3, 1), (12, 3, 2), (24, 2, 1)):
        false, found = alarms_of_a_fleet(rng, n, step, wide)
        fleets.append(
            {
                "diagnoses": n,
                "step": step,
                "scatter": wide,
                "false": false,
                "found": found,
            }
        )
    levels = {str(n): level_of_one_history(rng, n) for n in (3, 6, 12, 24, 100)}
    return {"level_at_0.01": levels, "fleets": fleets}


PARTS: dict[str, Callable[[argparse.Namespace], Figures]] = {
    "driver": driver,
    "compare": compare,
    "alarms": alarms,
    "cost": cost,
}
"""In this order: memory of the first is not hidden by that of the last."""


def main() -> None:
    """Measure the parts asked for and print all tables."""
    from fleet_arithmetic import print_tables

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/fleet_cost"))
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--jobs", type=int)
    parser.add_argument("--backend", default="local")
    parser.add_argument("--parts", nargs="*", choices=tuple(PARTS), default=list(PARTS))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "figures.json"
    figures: Figures = json.loads(file.read_text()) if file.is_file() else {}
    for name in PARTS:
        if name in options.parts:
            figures[name] = PARTS[name](options)
            write_json(figures, file)
    print_tables(figures)


if __name__ == "__main__":
    main()
