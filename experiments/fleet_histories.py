"""Simulated histories for ``45_fleet_cost.py``: false alarms and power of change points, and a store of many units."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.diagnosis.fleet.change_points import change_point, scatter
from gapscope.diagnosis.thresholds import EFFECT_FORM
from gapscope.fleets.drift import History, drift
from gapscope.fleets.store import FleetStore

COUNT = 20_000
"""Histories of which the level is measured [1]."""
LEVEL = 0.01
"""Level at which it is measured [1]."""
FLEETS, UNITS, CHANGED = 200, 300, 30
"""Simulated fleets, units of each, and those of them that change [1]."""
SHARE = 0.02
"""Standard deviation of an estimate, as a share of its value [1]."""
FIRST = datetime(2026, 1, 1)


def level_of_one_history(rng: np.random.Generator, n: int) -> float:
    """Share of the unchanged histories of n estimates whose p is at most ``LEVEL``."""
    alarms = 0
    for _ in range(COUNT):
        stds = np.exp(rng.normal(0.0, 0.5, n))
        alarms += change_point(stds * rng.standard_normal(n), stds).p <= LEVEL
    return alarms / COUNT


def alarms_of_a_fleet(
    rng: np.random.Generator, n: int, step: float, wide: float
) -> tuple[float, float]:
    """Share of the reported units that have not changed, and share of the changed units that are reported.

    Args:
        rng: draws the fleets.
        n: diagnoses of each unit.
        step: change of those that change, in standard deviations of one estimate.
        wide: scatter of the estimates in units of the deviations that come with them [1].
    """
    false, found = [], []
    for _ in range(FLEETS):
        reported = _reported(rng, n, step, wide)
        wrong = sum(unit >= CHANGED for unit in reported)
        false.append(wrong / max(len(reported), 1))
        found.append((len(reported) - wrong) / CHANGED)
    return float(np.mean(false)), float(np.mean(found))


def _reported(rng: np.random.Generator, n: int, step: float, wide: float) -> set[int]:
    """Units of one simulated fleet that are reported; the first ``CHANGED`` have changed at an unknown date."""
    said = np.full(n, SHARE)
    with_form = np.hypot(said, EFFECT_FORM)
    values = 1.0 + wide * with_form * rng.standard_normal((UNITS, n))
    for unit in range(CHANGED if step else 0):
        values[unit, rng.integers(2, n - 1) :] += step * wide * with_form[0]
    factor = scatter([(row, with_form) for row in values])
    times, kept = np.arange(n), np.full(n, "")
    histories = [
        History({"unit": unit}, times, kept, row, factor * with_form)
        for unit, row in enumerate(values)
    ]
    return {change.history.key["unit"] for change in drift(histories)}


def fill_store(folder: Path, units: int, days: int, seed: int) -> None:
    """A store with a diagnosis of each unit and day, each with three effects, as a fleet's run writes it."""
    rng, store = np.random.default_rng(seed), FleetStore(folder)
    for day in range(days):
        rows = list(_rows(rng, units, FIRST + timedelta(days=day)))
        effects = [effect for row, own in rows for effect in own]
        store.append([row for row, _ in rows], effects)


def _rows(
    rng: np.random.Generator, units: int, time: datetime
) -> Iterator[tuple[dict[str, Any], list[dict[str, Any]]]]:
    now = datetime.now(timezone.utc)
    for unit in range(units):
        name = f"unit{unit:06d}"
        common = {
            "result": f"{rng.integers(1 << 62):016x}",
            "case": f"s3://robots/{name}/{time:%Y-%m-%d}",
            "unit": name,
            "robot": "seven_joints",
            "date": f"{time:%Y-%m-%d}",
            "nominal_sha256": "0" * 40,
        }
        case = {
            **common,
            "name": name,
            "recorded_at": time,
            "joints": [f"joint_{j}" for j in range(1, 8)],
            "finished": now,
            "fingerprint": f"{rng.integers(1 << 62):064x}",
            "case_sha256": f"{rng.integers(1 << 62):064x}",
            "program_sha256": "0" * 64,
            "verdict": "effects_found",
            **{key: rng.random() for key in ("gap", "excess", "left", "closed")},
            "effects": ["coulomb_friction"],
            "recorded_seconds": 60.0,
            "bytes": 1_000_000,
            "seconds": rng.random(),
            "processor_seconds": rng.random(),
            "tries": 1,
            "error": "",
            "kept": "",
        }
        yield case, [_effect(rng, common, joint) for joint in (1, 2, 4)]


def _effect(
    rng: np.random.Generator, common: dict[str, Any], joint: int
) -> dict[str, Any]:
    value = 2.0 + 0.05 * rng.standard_normal()
    return {
        **common,
        "named": True,
        "effect": "coulomb_friction",
        "joint": joint,
        "parameter": "torque",
        "component": "",
        "si_unit": "N m",
        "value": value,
        "std": 0.04,
        "low": value - 0.08,
        "high": value + 0.08,
        "probability": 0.97,
        "share": 0.3,
    }
