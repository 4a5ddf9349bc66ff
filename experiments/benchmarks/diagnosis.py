"""What a diagnosis costs: against length, rate, joints and number of effects, and on simulated and real recordings.

Each diagnosis runs in a process of its own: processor time from reading the case to the finished diagnosis, without the
import of the libraries and without the report, and peak memory. Cheap cases are repeated. With another checkout, its
diagnosis of the same case runs in turns with this one's, and the ratio says how many times as fast this one is.

Sizes: the KUKA iiwa in simulation, three recordings, friction and a load, 60 s at 500 Hz but for what varies; for the
number of joints, chains of links. Real arms are read from the folder GAPSCOPE_DATA and left out if it is absent.

    python -m experiments.benchmarks.diagnosis CASE... [--reference CASE] [--against CHECKOUT] [--top 12] [--stages]

prints the slowest functions or stages. CASE is a folder or case file, or a part of the name of a point: ``real ur10
against``, ``60 s at 500 Hz, 2``. A table per case and checkout: time of the function's own, and with what it calls [s
of the processor], under the profiler; or the time of each stage without it.
"""

from __future__ import annotations

import argparse
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.model.terms import Terms

from .cases import (
    SPLIT,
    Measured,
    Simulated,
    real_cases,
    sample_cases,
    simulated_case,
    split_case,
)
from .child import ROOT, run_child
from .measure import (
    MEMORY,
    STOPPED,
    Point,
    Row,
    Settings,
    along,
    exponents,
    half_quartiles,
)

LENGTHS = (10.0, 30.0, 60.0, 180.0, 600.0, 1800.0, 3600.0)
"""[s]"""
RATES = (30.0, 100.0, 250.0, 500.0, 1000.0, 5000.0)
"""[Hz]"""
JOINTS, CHAIN_RATE = (1, 2, 4, 7, 10, 14), 250.0
"""Of chains of links, and the rate of their recordings [Hz]."""
EFFECTS = (0, 1, 2, 4, 6, 8)
"""How many effects of ``simulated_cases.EFFECTS`` the arm has."""
QUICK = (6.0, 12.0, 24.0)
"""Lengths of a quick run [s]."""
LIMIT = 3600.0
"""Time after which a diagnosis is stopped [s]."""
BUDGET = 60.0
"""A case is repeated as long as its repetitions stay within this processor time [s]."""
OTHER = "the other checkout"


@dataclass(frozen=True)
class Planned:
    """A diagnosis to measure.

    Attributes:
        name: of the point.
        place: makes the case, in a folder, when it is measured.
        sizes: of a simulated one.
    """

    name: str
    place: Callable[[Path], Measured]
    sizes: Mapping[str, float | str] = field(default_factory=dict)


def points(settings: Settings) -> list[Point]:
    """Cheap ones first, so that much is stored early."""
    planned = [*named_cases(settings.quick), *sizes(settings.quick)]
    planned += [Planned(f"case {case.name}", _given(case)) for case in settings.cases]
    return [Point(p.name, partial(_measure, settings, p)) for p in planned]


def conclusions(rows: list[Row]) -> list[Row]:
    """Exponents of growth along each size, the others as they are by default."""
    found = []
    for size, base in (
        ("seconds", Simulated()),
        ("rate_hz", Simulated()),
        ("effects", Simulated()),
        ("joints", chain(1)),
    ):
        others = {k: v for k, v in base.sizes.items() if k != size}
        found += exponents(along(rows, size, others), size)
    return found


def named_cases(quick: bool = False) -> list[Planned]:
    """Sample cases, real arms, and real arms against a reference, as far as they are there."""
    samples = [Planned(f"sample {case.name}", _given(case)) for case in sample_cases()]
    real = [Planned(f"real {case.name}", _given(case)) for case in real_cases()]
    if quick or not real:
        return samples[:1] + real[:1]
    split = [
        Planned(f"real {name} against a reference", partial(split_case, name))
        for name in SPLIT
    ]
    return samples + real + split


def sizes(quick: bool = False) -> list[Planned]:
    """Simulated cases along which one size varies, the smallest first."""
    if quick:
        short = [Simulated(seconds) for seconds in QUICK]
        return [_simulated(case) for case in (*short, chain(2, QUICK[0]))]
    cases = [
        *(chain(joints) for joints in JOINTS),
        *(Simulated(rate=rate) for rate in RATES),
        *(Simulated(effects=effects) for effects in EFFECTS),
        Simulated(effects=1, rings=True),
        *(Simulated(seconds) for seconds in LENGTHS),
    ]
    # the curves cross where all sizes are the default ones
    return [_simulated(case) for case in dict.fromkeys(cases)]


def chain(joints: int, seconds: float = 60.0) -> Simulated:
    """A chain of links."""
    return Simulated(seconds, CHAIN_RATE, joints)


def _simulated(case: Simulated) -> Planned:
    def place(folder: Path) -> Measured:
        return Measured(case.name, simulated_case(case, folder))

    return Planned(case.name, place, case.sizes)


def _given(case: Measured) -> Callable[[Path], Measured]:
    return lambda _: case


def _measure(settings: Settings, planned: Planned) -> list[Row]:
    """The row of one case."""
    case = planned.place(settings.out / "cases")
    checkouts = {"this": ROOT}
    if settings.against:
        checkouts["other"] = settings.against
    found: dict[str, list[dict[str, Any]]] = {key: [] for key in checkouts}
    for done in range(1, settings.rounds + 1):
        for key, checkout in checkouts.items():
            found[key].append(_run(case, checkout))
        spent = sum(run["cpu"] for runs in found.values() for run in runs)
        if spent * (done + 1) / done > BUDGET:
            break
    return [_row(planned, found["this"], found.get("other"))]


def _run(case: Measured, checkout: Path) -> dict[str, Any]:
    """What the child prints; a diagnosis that was stopped has the limit as its time, and nothing else."""
    reference = ["--reference", case.reference] if case.reference else []
    try:
        return run_child(
            "diagnose_case.py", case.case, *reference, checkout=checkout, timeout=LIMIT
        )
    except subprocess.TimeoutExpired:
        return {"cpu": LIMIT, "memory_mb": 0.0, STOPPED: LIMIT, "named": None}


def _row(
    planned: Planned, runs: list[dict[str, Any]], others: list[dict[str, Any]] | None
) -> Row:
    """Time, memory and what was named; beside another checkout if that ran as well."""
    times = [run["cpu"] for run in runs]
    details: dict[str, float | str] = {MEMORY: _peak(runs)}
    if "joints" in planned.sizes:
        # each effect on each joint or link that it may be placed on
        details["hypotheses"] = len(Terms(int(planned.sizes["joints"])).all)
    if any(STOPPED in run for run in runs):
        details[STOPPED] = LIMIT
    row = Row(
        planned.name,
        _median(times),
        "s",
        half_quartiles(times),
        note=_names(runs[0]),
        details=details,
        sizes=planned.sizes,
    )
    if others is None:
        return row
    other = [run["cpu"] for run in others]
    ratios = [before / now for now, before in zip(times, other, strict=True)]
    details |= {"before [s]": _median(other), "before [MB]": _peak(others)}
    if others[0]["named"] != runs[0]["named"]:
        details["before named"] = _names(others[0])
    return replace(
        row,
        ratio=_median(ratios),
        ratio_spread=half_quartiles(ratios),
        yardstick=OTHER,
        details=details,
    )


def _median(values: Sequence[float]) -> float:
    return float(np.median(values))


def _peak(runs: Sequence[Mapping[str, Any]]) -> float:
    return max(run["memory_mb"] for run in runs)


def _names(run: Mapping[str, Any]) -> str:
    """The effects named, in a few words."""
    if run["named"] is None:
        return "stopped"
    named = [f"{name} {_numbers(joints)}".strip() for name, joints in run["named"]]
    return ", ".join(named) or "none named"


def _numbers(joints: Sequence[int]) -> str:
    return " ".join(map(str, joints))


HEAD = "| function | calls | own [s] | with what it calls [s] |\n|---|---|---|---|"


def cases(
    words: Sequence[str], reference: Path | None, out: Path
) -> Iterator[Measured]:
    """The cases that words name.

    Raises:
        SystemExit: a word names no point, or several; lists them.
    """
    planned = [*named_cases(), *sizes()]
    for word in words:
        if Path(word).exists():
            yield Measured(Path(word).name, Path(word), reference)
            continue
        found = [each for each in planned if word == each.name]
        found = found or [each for each in planned if word in each.name]
        if len(found) != 1:
            names = "\n  ".join(each.name for each in found or planned)
            raise SystemExit(f"{word!r} names {len(found)} points\n  {names}")
        yield found[0].place(out / "cases")


def functions(found: dict[str, Any]) -> str:
    """A profile as a table."""
    lines = [
        f"| `{row['function']}` | {row['calls']} | {row['own']:.2f} | {row['with_called']:.2f} |"
        for row in found["slowest"]
    ]
    return "\n".join([HEAD, *lines])


def stages(found: dict[str, Any]) -> str:
    """The stages as a table."""
    lines = [f"| {name} | {spent:.2f} |" for name, spent in found["stages"].items()]
    return "\n".join(["| stage | processor [s] |\n|---|---|", *lines])


def main() -> None:
    """Profile and print."""
    parser = argparse.ArgumentParser(description="Slowest functions of a diagnosis.")
    parser.add_argument("cases", nargs="+", metavar="CASE")
    parser.add_argument("--reference", type=Path, help="of a case given as a path")
    parser.add_argument("--against", type=Path, help="another checkout, profiled first")
    parser.add_argument("--top", type=int, default=12, help="functions in a table")
    parser.add_argument("--stages", action="store_true", help="no profile, but stages")
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks/diagnosis"))
    options = parser.parse_args()
    checkouts = {"before": options.against.resolve()} if options.against else {}
    checkouts["now"] = ROOT
    for case in cases(options.cases, options.reference, options.out):
        reference = ["--reference", case.reference] if case.reference else []
        words = [case.case, *reference]
        if not options.stages:
            words += ["--slowest", options.top]
        for when, checkout in checkouts.items():
            found = run_child("diagnose_case.py", *words, checkout=checkout)
            text = stages(found) if options.stages else functions(found)
            print(
                f"\n### {case.name}, {when}: {found['cpu']:.1f} s\n\n{text}", flush=True
            )


if __name__ == "__main__":
    main()
