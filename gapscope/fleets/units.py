"""The units of one type of robot compared: which effects they share, and which unit stands out."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from gapscope.diagnosis.fleet.compare_units import (
    ORDER,
    kind_of,
    pooled_parameter,
    units_agree,
)
from gapscope.diagnosis.fleet.heterogeneity import Pooled
from gapscope.fleets.rows import PLACE

EXTREMES = 5
"""Units that are listed as the farthest from the common value, at most [1]."""


def latest(cases: pd.DataFrame) -> pd.DataFrame:
    """The last diagnosis of each unit of each type of robot."""
    order = cases.sort_values(["recorded_at", "result"], kind="stable")
    return order.drop_duplicates(["robot", "unit"], keep="last")


def shared_effects(effects: pd.DataFrame, units: int) -> list[dict[str, Any]]:
    """Effects of the last diagnoses of several units; see ``gapscope.diagnosis.fleet.compare_units``.

    Args:
        effects: numbers of the named effects, of one diagnosis a unit.
        units: number of units that were diagnosed.

    Returns:
        An entry of ``fleet.json`` for each effect on each place: those on all units first, then the most frequent.
    """
    made = [
        _effect(key, rows, units) for key, rows in effects.groupby(PLACE, dropna=False)
    ]
    return sorted(made, key=lambda row: (ORDER.index(row["kind"]), -row["units"]))


def _effect(key: Any, rows: pd.DataFrame, units: int) -> dict[str, Any]:
    count = rows["unit"].nunique()
    numbers = rows[rows["parameter"] != ""]
    by_number = numbers.groupby(["parameter", "component", "si_unit"])
    # a number that only some of the units have is left out
    complete = [(names, group) for names, group in by_number if len(group) == count]
    together = [_pooled(group) for _, group in complete]
    agree = units_agree(together) if count > 1 else None
    effect, joint, link = key
    return {
        "effect": effect,
        "joint": None if pd.isna(joint) else int(joint),
        "link": None if pd.isna(link) else int(link),
        "kind": kind_of(agree, on_all=count == units),
        "units": count,
        "agree": agree,
        "share": float(rows["share"].median()),
        "parameters": [
            _parameter(names, group, pool)
            for (names, group), pool in zip(complete, together, strict=True)
        ],
    }


def _pooled(group: pd.DataFrame) -> Pooled | None:
    stds = [std if std > 0 else None for std in group["std"]]
    return pooled_parameter(group["parameter"].iloc[0], list(group["value"]), stds)


def _parameter(names: Any, group: pd.DataFrame, pool: Pooled | None) -> dict[str, Any]:
    name, component, unit = names
    return {
        "name": name,
        "component": component,
        "unit": unit,
        "together": None if pool is None else vars(pool),
        "extremes": [] if pool is None else list(_extremes(group, pool)),
    }


def _extremes(group: pd.DataFrame, pool: Pooled) -> Iterator[dict[str, Any]]:
    """The units farthest from the common value, in standard deviations of a single unit."""
    std = group["std"].fillna(0.0).to_numpy(float)
    spread = np.hypot(std, pool.between)
    spread = np.where(spread > 0, spread, np.inf)
    deviation = (group["value"].to_numpy(float) - pool.estimate) / spread
    for k in np.argsort(-np.abs(deviation), kind="stable")[:EXTREMES]:
        row = group.iloc[k]
        yield {
            "unit": row["unit"],
            "value": float(row["value"]),
            "std": None if pd.isna(row["std"]) else float(row["std"]),
            "deviation": float(deviation[k]),
        }
