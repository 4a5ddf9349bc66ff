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
from dataclasses import replace
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


Place = Callable[[Path], Measured]
"""Makes a case, in a folder, when it is measured."""


def points(settings: Settings) -> list[Point]:
    """Cheap ones first, so that much is stored early."""
    places = {}
    # sample cases and real arms, as far as they are there
    for kind, cases in {"sample": sample_cases(), "real": real_cases()}.items():
        for case in cases[:1] if settings.quick else cases:
            places[f"{kind} {case.name}"] = _given(case)
    places |= sizes(settings.quick)
    places |= {f"case {case.name}": _given(case) for case in settings.cases}
    return [
        Point(name, partial(_measure, settings, name, place))
        for name, place in places.items()
    ]


def sizes(quick: bool = False) -> dict[str, Place]:
    """Simulated cases along which one size varies, the smallest first; the curves cross at the default sizes."""
    cases = [
        *(Simulated(60.0, CHAIN_RATE, joints) for joints in JOINTS),
        *(Simulated(effects=effects) for effects in EFFECTS),
        *(Simulated(seconds) for seconds in LENGTHS),
    ]
    if quick:
        short = [Simulated(seconds) for seconds in QUICK]
        cases = [*short, Simulated(QUICK[0], CHAIN_RATE, 2)]
    return {case.name: partial(_simulated, case) for case in cases}


def _simulated(case: Simulated, folder: Path) -> Measured:
    return Measured(case.name, simulated_case(case, folder))


def _given(case: Measured) -> Place:
    return lambda _: case


def _measure(settings: Settings, name: str, place: Place) -> list[Row]:
    """The row of one case."""
    case = place(settings.out / "cases")
    checkouts = {"this": ROOT}
    if settings.against:
        checkouts["other"] = settings.against
    found = {key: [] for key in checkouts}
    for done in range(1, settings.rounds + 1):
        for key, checkout in checkouts.items():
            found[key].append(_run(case, checkout))
        spent = sum(run["cpu"] for runs in found.values() for run in runs)
        if spent * (done + 1) / done > BUDGET:
            break
    return [_row(name, found["this"], found.get("other"))]


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
    name: str, runs: list[dict[str, Any]], others: list[dict[str, Any]] | None
) -> Row:
    """Time, memory and what was named; beside another checkout if that ran as well."""
    (time, spread, peak), named = _figures(runs), _names(runs[0])
    details = {MEMORY: peak}
    if any(STOPPED in run for run in runs):
        details[STOPPED] = LIMIT
    row = Row(name, time, "s", spread, note=named, details=details)
    if others is None:
        return row
    before, _, before_peak = _figures(others)
    pairs = zip(runs, others, strict=True)
    ratios = [other["cpu"] / run["cpu"] for run, other in pairs]
    details |= {"before [s]": before, "before [MB]": before_peak}
    if others[0]["named"] != runs[0]["named"]:
        details["before named"] = _names(others[0])
    ratio, ratio_spread = float(np.median(ratios)), half_quartiles(ratios)
    return replace(row, ratio=ratio, ratio_spread=ratio_spread, yardstick=OTHER)


def _figures(runs: Sequence[Mapping[str, Any]]) -> tuple[float, float | None, float]:
    """Median time [s], half the distance between its quartiles, and largest memory [MB]."""
    times = [run["cpu"] for run in runs]
    peak = max(run["memory_mb"] for run in runs)
    return float(np.median(times)), half_quartiles(times), peak


def _names(run: Mapping[str, Any]) -> str:
    """The effects named, in a few words."""
    if run["named"] is None:
        return "stopped"
    named = [" ".join([name, *map(str, joints)]) for name, joints in run["named"]]
    return ", ".join(named) or "none named"
