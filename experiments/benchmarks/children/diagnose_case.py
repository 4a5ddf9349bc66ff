"""Diagnose one case and print as JSON what it cost; imports nothing of the benchmarks, so any checkout can be measured.

    python experiments/benchmarks/children/diagnose_case.py CASE [--reference CASE] [--seconds S] [--slowest N]

Printed are processor and wall time [s] from reading the case to the finished diagnosis, those of each stage that the
diagnosis tells of, peak memory [MB], and what was named. ``--slowest`` adds the functions that take the most of a
profile, whose own cost makes the times of such a run useless.
"""

from __future__ import annotations

import argparse
import cProfile
import json
import pstats
import re
import resource
import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any


def peak_mb() -> float:
    """The most memory that this process has held [MB].

    Linux counts it anew for each program; ``getrusage`` would begin with the peak of the process that started this one.
    """
    try:
        text = Path("/proc/self/status").read_text(encoding="ascii")
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    found = re.search(r"^VmHWM:\s*(\d+) kB", text, re.MULTILINE)
    assert found is not None
    return int(found[1]) / 1024


class Stages:
    """Processor time [s] of each stage that a diagnosis tells of."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}
        self._name, self._start = "reads the case", time.process_time()

    def __call__(self, message: str) -> None:
        """End a stage and begin the next; what a search adds belongs to the search."""
        if message.startswith(("adds ", "finds ")):
            return
        now = time.process_time()
        self.spent[self._name] = self.spent.get(self._name, 0.0) + now - self._start
        self._name, self._start = message, now


def diagnosed(case: Path, reference: Path | None, seconds: float | None) -> Any:
    """The result of a diagnosis, and its stages."""
    import gapscope

    stages = Stages()
    loaded = gapscope.load_case(case, any_unit=True)
    if seconds is not None:
        cut = tuple(r.part(r.t - r.t[0] < seconds) for r in loaded.recordings)
        loaded = replace(loaded, recordings=cut, file=None)
    result = gapscope.diagnose(loaded, against=reference, progress=stages)
    stages("")
    return result, stages


def slowest(profile: cProfile.Profile, count: int) -> list[dict[str, Any]]:
    """The functions that take the most time of their own [s]."""
    stats = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    rows = [
        {
            "function": f"{_short(file)}:{name}",
            "calls": calls,
            "own": own,
            "with_called": total,
        }
        for (file, _, name), (_, calls, own, total, _) in stats.items()
    ]
    return sorted(rows, key=lambda row: -row["own"])[:count]


def _short(file: str) -> str:
    """A path from the package on."""
    parts = Path(file).parts
    for package in ("gapscope", "site-packages"):
        if package in parts:
            return "/".join(parts[parts.index(package) :])
    return Path(file).name


def main() -> None:
    """Diagnose and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("case", type=Path)
    parser.add_argument("--reference", type=Path)
    parser.add_argument("--seconds", type=float, help="only the first of a recording")
    parser.add_argument("--slowest", type=int, default=0, metavar="N")
    options = parser.parse_args()
    import gapscope.interface.diagnose  # noqa: F401 (what follows is the work alone)

    imports = time.process_time()
    profile = cProfile.Profile(time.process_time) if options.slowest else None
    wall, cpu = time.perf_counter(), time.process_time()
    with profile or nullcontext():
        result, stages = diagnosed(options.case, options.reference, options.seconds)
    document = result.document
    found = {
        "imports": imports,
        "cpu": time.process_time() - cpu,
        "wall": time.perf_counter() - wall,
        "memory_mb": peak_mb(),
        "stages": stages.spent,
        "verdict": document["verdict"],
        "named": [[e["effect"], e["joints"]] for e in document["effects"]],
        "possible": [[e["effect"], e["joints"]] for e in document["possible"]],
    }
    if profile is not None:
        found["slowest"] = slowest(profile, options.slowest)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
