"""The fleet as data: ``fleet.json``."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import Any

import jsonschema
import numpy as np
import pandas as pd

from gapscope.arm.io.json_file import plain
from gapscope.diagnosis.thresholds import FALSE_CHANGES
from gapscope.fleets.drift import Change, History, drift, histories
from gapscope.fleets.store import FleetStore
from gapscope.fleets.units import latest, shared_effects

MOST = 200
"""Entries of a list: the first of units, changes and failures are enough to act on; Parquet has all [1]."""
POINTS = 60
"""Points of the history that goes with a change: the last ones [1]."""
COLUMNS = [
    "result",
    "case",
    "unit",
    "robot",
    "date",
    "recorded_at",
    "joints",
    "nominal_sha256",
    "verdict",
    "gap",
    "excess",
    "left",
    "closed",
    "effects",
    "tries",
    "error",
    "kept",
    "seconds",
    "processor_seconds",
    "recorded_seconds",
]


def fleet_document(store: FleetStore) -> dict[str, Any]:
    """Compare what a store holds, one type of robot after the other, so that no more is in memory.

    Raises:
        InputError: the store has no results, or they cannot be read.
    """
    rows = store.cases(COLUMNS)
    failed, cases = rows[rows["error"] != ""], rows[rows["error"] == ""]
    cases = cases.assign(type=_types(cases))
    everything: list[History] = []
    robots, factors = [], []
    for _, of_type in cases.groupby("type"):
        robot = of_type["robot"].iloc[0]
        effects = store.effects(robot, of_type["result"])
        named = effects[effects["named"].astype(bool)]
        found, scatter = histories(of_type, named)
        everything += found
        last = latest(of_type)
        of_last = named[named["result"].isin(last["result"])]
        robots.append(_robot(of_type, last, shared_effects(of_last, len(last))))
        factors += [
            {"robot": robot, "effect": effect, "parameter": name, "factor": factor}
            for (effect, name), factor in scatter.items()
        ]
    changes = drift(everything)
    content = {
        "schema": 1,
        "cases": len(rows),
        "failed": len(failed),
        "units": sum(robot["units"] for robot in robots),
        "recorded_hours": float(cases["recorded_seconds"].sum() / 3600),
        "processor_hours": float(rows["processor_seconds"].sum() / 3600),
        "robots": robots,
        "histories": len(everything),
        "false_share": FALSE_CHANGES,
        "scatter": factors,
        "changes": [_change(change) for change in changes[:MOST]],
        "changes_in_all": len(changes),
        "worst": _worst(latest(cases), changes),
        "failures": [_failure(row) for row in failed.head(MOST).to_dict("records")],
    }
    document: dict[str, Any] = plain(content, null_if_not_finite=True)
    validate(document)
    return document


def validate(document: Any) -> None:
    """Check a document against ``fleet.schema.json``; raises ``jsonschema.ValidationError``."""
    jsonschema.validate(document, schema())


@cache
def schema() -> Any:
    """Content of ``fleet.schema.json``."""
    text = files("gapscope.fleets").joinpath("fleet.schema.json").read_text("utf-8")
    return json.loads(text)


def _types(cases: pd.DataFrame) -> pd.Series:
    """Robot and joints of each case as one text: only arms of one type are compared."""
    joints = cases["joints"].map(" ".join)
    return cases["robot"] + "\0" + joints


def _robot(
    cases: pd.DataFrame, last: pd.DataFrame, effects: list[dict[str, Any]]
) -> dict[str, Any]:
    return {
        "robot": cases["robot"].iloc[0],
        "joints": list(cases["joints"].iloc[0]),
        "cases": len(cases),
        "units": len(last),
        "nominal_arms": int(last["nominal_sha256"].nunique()),
        "effects": effects[:MOST],
    }


def _change(change: Change) -> dict[str, Any]:
    history, k = change.history, change.position
    days = [f"{time:%Y-%m-%d}" for time in pd.to_datetime(history.times)]
    key = history.key
    return {
        "unit": key["unit"],
        "kind": change.kind,
        "effect": key["effect"],
        "joint": key["joint"] or None,
        "link": key["link"] or None,
        "parameter": key["parameter"],
        "component": key["component"],
        "si_unit": key["si_unit"],
        "last_before": days[k - 1],
        "first_after": days[k],
        "before": {"value": change.before[0], "std": change.before[1]},
        "after": {"value": change.after[0], "std": change.after[1]},
        "p": change.p,
        "kept": history.kept[k],
        "history": _points(history, days),
    }


def _points(history: History, days: list[str]) -> list[dict[str, Any]]:
    stds = [None] * len(days) if history.stds is None else history.stds.tolist()
    points = [
        {"date": day, "value": value, "std": std}
        for day, value, std in zip(days, history.values.tolist(), stds, strict=True)
    ]
    return points[-POINTS:]


def _worst(last: pd.DataFrame, changes: tuple[Change, ...]) -> list[dict[str, Any]]:
    """The last diagnoses, those with the largest gap over the floor first."""
    units = [change.history.key["unit"] for change in changes]
    counts = pd.Series(units, dtype=object).value_counts()
    order = last.sort_values(["excess", "unit"], ascending=[False, True]).head(MOST)
    keys = ("unit", "robot", "case", "date", "verdict", "gap", "excess", "left")
    made = []
    for row in order.to_dict("records"):
        entry = {key: row[key] for key in (*keys, "closed", "kept")}
        entry["effects"] = list(np.atleast_1d(row["effects"]))
        entry["changes"] = int(counts.get(row["unit"], 0))
        made.append(entry)
    return made


def _failure(row: dict[str, Any]) -> dict[str, Any]:
    keys = ("case", "unit", "date", "error", "tries")
    return {key: row[key] for key in keys}
