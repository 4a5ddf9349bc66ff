"""What a fleet's diagnoses say together: drift of units over days and effects that units share."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import false_discovery_control

from gapscope.arm.io.json_file import plain, schema_fault
from gapscope.diagnosis.change_points import (
    appearance,
    change_point,
    change_points,
    scatter,
)
from gapscope.diagnosis.compare_units import ANGLES
from gapscope.diagnosis.thresholds import EFFECT_FORM, FALSE_CHANGES, SHORTEST_HISTORY
from gapscope.fleets.cases import latest, shared_effects
from gapscope.fleets.store import NUMBER, PLACE, FleetStore

# What changed over time on which unit: a test of every effect of every unit, and one account of false alarms.


UNIT = ["unit", "nominal_sha256"]
"""A unit as long as its nominal arm is the same: values are relative to it, and step with it."""
VALUE, APPEARED, VANISHED = "value", "appeared", "vanished"


@dataclass(frozen=True)
class History:
    """One number of an effect of a unit over time, or whether the effect was found at all.

    Attributes:
        key: unit, effect, joint, link, parameter, component and SI unit; the last three are empty for ``found``.
        times: of the n diagnoses, in order, (n,).
        kept: folders in which they are kept, empty if they are not, (n,).
        values: estimates in the SI unit, or 1 and 0 for found and not, (n,).
        stds: their standard deviations with the error of form and the scatter seen in the fleet, (n,); ``None`` for
            found and not.
    """

    key: dict[str, Any]
    times: np.ndarray
    kept: np.ndarray
    values: np.ndarray
    stds: np.ndarray | None = None

    @property
    def p(self) -> float:
        """Probability that an unchanged history looks as changed [1]."""
        if self.stds is None:
            return appearance(self.values.astype(bool).tolist())[1]
        return change_point(self.values, self.stds).p


@dataclass(frozen=True)
class Change:
    """A change of a unit between two diagnoses.

    Attributes:
        history: what changed.
        kind: ``value``, ``appeared`` or ``vanished``.
        position: number of diagnoses before it.
        before: value and standard deviation before; the share of diagnoses that name the effect for the other kinds.
        after: the same, after.
        p: upper bound of the probability of such a change in a history without one [1].
    """

    history: History
    kind: str
    position: int
    before: tuple[float, float | None]
    after: tuple[float, float | None]
    p: float


@dataclass(frozen=True)
class Drift:
    """All changes of a fleet.

    Attributes:
        changes: the clearest first.
        tested: number of histories that were tested.
        scatter: by effect and parameter, the factor by which estimates scatter beyond their standard deviations [1].
    """

    changes: tuple[Change, ...]
    tested: int
    scatter: dict[tuple[str, str], float]


def histories(
    cases: pd.DataFrame, effects: pd.DataFrame
) -> tuple[list[History], dict[tuple[str, str], float]]:
    """The histories of the units of one type of robot, and the scatter of each parameter.

    Args:
        cases: rows of diagnosed cases: ``result``, ``unit``, ``nominal_sha256``, ``recorded_at``, ``kept``.
        effects: numbers of the named effects of these results.
    """
    dated = effects.merge(cases[["result", "recorded_at", "kept"]], on="result")
    dated = dated.sort_values(["recorded_at", "result"], kind="stable")
    # an effect without joint or link is on the arm
    dated[["joint", "link"]] = dated[["joint", "link"]].fillna(0).astype(int)
    found = list(_found(cases, dated))
    values, factors = _values(dated)
    return [*values, *found], factors


def _values(
    dated: pd.DataFrame,
) -> tuple[list[History], dict[tuple[str, str], float]]:
    """The histories of numbers, with the scatter of each parameter over all units in their deviations."""
    known = dated[(dated["std"] > 0) & ~dated["parameter"].isin(ANGLES)]
    made: list[History] = []
    factors: dict[tuple[str, str], float] = {}
    for parameter, rows in known.groupby(["effect", "parameter"]):
        plain = []
        for key, group in rows.groupby([*UNIT, *NUMBER, "si_unit"]):
            history = _history(
                dict(zip([*UNIT, *NUMBER, "si_unit"], key, strict=True)), group
            )
            plain.append(history)
        factor = scatter([(h.values, h.stds) for h in plain if h.stds is not None])
        factors[parameter] = factor
        for history in plain:
            if len(history.values) >= SHORTEST_HISTORY and history.stds is not None:
                made.append(replace(history, stds=factor * history.stds))
    return made, factors


def _history(key: dict[str, Any], rows: pd.DataFrame) -> History:
    """A history of estimates; the error of the effect's form is part of their deviations, as between units."""
    values = rows["value"].to_numpy(float)
    form = EFFECT_FORM * np.abs(values).mean()
    stds = np.hypot(rows["std"].to_numpy(float), form)
    return History(key, *_when(rows), values, stds)


def _when(rows: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    return rows["recorded_at"].to_numpy(), rows["kept"].to_numpy()


def _found(cases: pd.DataFrame, dated: pd.DataFrame) -> Iterator[History]:
    """Whether each effect of a unit was found in its diagnoses."""
    order = cases.sort_values(["recorded_at", "result"], kind="stable")
    of_unit = dict(iter(order.groupby(UNIT)))
    for key, group in dated.groupby([*UNIT, *PLACE]):
        unit = of_unit[key[:2]]
        found = unit["result"].isin(group["result"]).to_numpy(float)
        if len(found) >= SHORTEST_HISTORY and not found.all():
            names = dict(zip([*UNIT, *PLACE], key, strict=True))
            names |= {"parameter": "", "component": "", "si_unit": ""}
            yield History(names, *_when(unit), found)


def drift(all_histories: list[History]) -> tuple[Change, ...]:
    """The changes in all histories of a fleet, the clearest first.

    Of the histories that are called changed, a share ``FALSE_CHANGES`` is not, on average [benjamini1995]. The largest
    p among them is the level at which the parts before and after a change are tested again.
    """
    p = np.array([history.p for history in all_histories])
    if not len(p):
        return ()
    chosen = false_discovery_control(p) <= FALSE_CHANGES
    level = float(p[chosen].max(initial=0.0))
    changes: list[Change] = []
    for k in np.flatnonzero(chosen):
        changes += _changes(all_histories[k], level)
    return tuple(sorted(changes, key=lambda change: change.p))


def _changes(history: History, level: float) -> Iterator[Change]:
    if history.stds is None:
        position, p = appearance(history.values.astype(bool).tolist())
        before = float(history.values[:position].mean())
        after = float(history.values[position:].mean())
        kind = APPEARED if after > before else VANISHED
        yield Change(history, kind, position, (before, None), (after, None), p)
        return
    for found in change_points(history.values, history.stds, level):
        before_value = (found.before, found.before_std)
        after_value = (found.after, found.after_std)
        yield Change(history, VALUE, found.position, before_value, after_value, found.p)


# The fleet as data: ``fleet.json``.


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
    error = schema_fault(document, "fleet")
    if error is not None:
        raise error


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
