"""What a diagnosis costs: against length, joints and number of effects, and on simulated and real recordings.

Each diagnosis runs in a process of its own: processor time from reading the case to the finished diagnosis, without the
import of the libraries and without the report, and peak memory. Cheap cases are repeated. With another checkout, its
diagnosis of the same case runs in turns with this one's, and the ratio says how many times as fast this one is.

Sizes: the KUKA iiwa in simulation, three recordings, friction and a load, 60 s at 500 Hz but for what varies; for the
number of joints, chains of links. Real arms are read from the folder GAPSCOPE_DATA and left out if it is absent.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .cases import (
    Measured,
    Simulated,
    real_cases,
    sample_cases,
    simulated_case,
)
from .child import ROOT, run_child
from .measure import (
    MEMORY,
    STOPPED,
    Point,
    Row,
    Settings,
    half_quartiles,
)

LENGTHS = (10.0, 60.0, 600.0, 3600.0)
"""[s]"""
JOINTS, CHAIN_RATE = (1, 4, 7, 10, 14), 250.0
"""Of chains of links, and the rate of their recordings [Hz]."""
EFFECTS = (0, 1, 4, 8)
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
    """

    name: str
    place: Callable[[Path], Measured]


def points(settings: Settings) -> list[Point]:
    """Cheap ones first, so that much is stored early."""
    planned = [*named_cases(settings.quick), *sizes(settings.quick)]
    planned += [Planned(f"case {case.name}", _given(case)) for case in settings.cases]
    return [Point(p.name, partial(_measure, settings, p)) for p in planned]


def named_cases(quick: bool = False) -> list[Planned]:
    """Sample cases and real arms, as far as they are there."""
    samples = [Planned(f"sample {case.name}", _given(case)) for case in sample_cases()]
    real = [Planned(f"real {case.name}", _given(case)) for case in real_cases()]
    return samples[:1] + real[:1] if quick else samples + real


def sizes(quick: bool = False) -> list[Planned]:
    """Simulated cases along which one size varies, the smallest first."""
    if quick:
        short = [Simulated(seconds) for seconds in QUICK]
        return [_simulated(case) for case in (*short, chain(2, QUICK[0]))]
    cases = [
        *(chain(joints) for joints in JOINTS),
        *(Simulated(effects=effects) for effects in EFFECTS),
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

    return Planned(case.name, place)


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
    if any(STOPPED in run for run in runs):
        details[STOPPED] = LIMIT
    row = Row(
        planned.name,
        _median(times),
        "s",
        half_quartiles(times),
        note=_names(runs[0]),
        details=details,
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
