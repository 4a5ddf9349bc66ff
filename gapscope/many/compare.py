"""What a fleet's diagnoses say together: drift of units over days and effects that units share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import false_discovery_control

from gapscope.arm.io.json_file import plain, schema_fault
from gapscope.diagnosis.change_points import (
    ChangePoint,
    appearance,
    change_point,
    change_points,
    scatter,
)
from gapscope.diagnosis.compare_units import ANGLES, ORDER, shared_effects
from gapscope.diagnosis.document.numbers import Number
from gapscope.diagnosis.document.wording import Document
from gapscope.diagnosis.thresholds import EFFECT_FORM, FALSE_CHANGES, SHORTEST_HISTORY
from gapscope.many.rows import NUMBER, PLACE, FleetStore

# What changed over time on which unit: a test of every effect of every unit, and one account of false alarms.


UNIT = ["unit", "nominal_sha256"]
"""A unit as long as its nominal arm is the same: values are relative to it, and step with it."""
VALUE, APPEARED, VANISHED = "value", "appeared", "vanished"
IN_TIME = ["recorded_at", "result"]
KEPT = ["recorded_at", "kept"]
POINTS = 60
"""Points of the history that goes with a change: the last ones [1]."""


@dataclass(frozen=True)
class History:
    """One number of an effect of a unit over time, or whether the effect was found at all.

    Attributes:
        key: unit, effect, joint, link, parameter, component and SI unit; the last three are empty for ``found``.
        diagnoses: ``recorded_at`` of n of them, in order, and ``kept``, the folder in which each is kept, or nothing.
        values: estimates in the SI unit, or 1 and 0 for found and not, (n,).
        stds: their standard deviations with the error of form and the scatter seen in the fleet, (n,); ``None`` for
            found and not.
    """

    key: dict[str, Any]
    diagnoses: pd.DataFrame
    values: np.ndarray
    stds: np.ndarray | None = None

    @cached_property
    def first(self) -> ChangePoint:
        """The most likely change."""
        if self.stds is None:
            return appearance(self.values.astype(bool).tolist())
        return change_point(self.values, self.stds)

    def changes(self, level: float) -> Iterator[Document]:
        """Its changes as ``fleet.json`` has them; parts before and after one are tested again at a level."""
        days = [f"{time:%Y-%m-%d}" for time in self.diagnoses["recorded_at"]]
        stds: Sequence[float | None] = [None] * len(days)
        # of found and not found a single change is looked for
        every: Sequence[ChangePoint] = (self.first,)
        kind = VALUE
        if self.stds is not None:
            every, stds = (
                change_points(self.values, self.stds, level),
                self.stds.tolist(),
            )
        elif self.first.after > self.first.before:
            kind = APPEARED
        else:
            kind = VANISHED
        points = zip(days, self.values.tolist(), stds, strict=True)
        history = [{"date": day, "value": x, "std": std} for day, x, std in points]
        for found in every:
            k = found.position
            yield {
                **{name: self.key[name] for name in ("unit", *NUMBER, "si_unit")},
                "joint": self.key["joint"] or None,
                "link": self.key["link"] or None,
                "kind": kind,
                "last_before": days[k - 1],
                "first_after": days[k],
                # a share has no deviation
                "before": {"value": found.before, "std": found.before_std or None},
                "after": {"value": found.after, "std": found.after_std or None},
                "p": found.p,
                "kept": self.diagnoses["kept"].iloc[k],
                "history": history[-POINTS:],
            }


def histories(
    cases: pd.DataFrame, effects: pd.DataFrame
) -> tuple[list[History], dict[tuple[str, str], float]]:
    """The histories of the units of one type of robot, and the scatter of each parameter over all units.

    The scatter is part of the deviations of numbers.

    Args:
        cases: rows of diagnosed cases: ``result``, ``unit``, ``nominal_sha256``, ``recorded_at``, ``kept``.
        effects: numbers of the named effects of these results.
    """
    dated = effects.merge(cases[["result", "recorded_at", "kept"]], on="result")
    # results break ties of dates, the same way in each run
    dated = dated.sort_values(IN_TIME, kind="stable")
    # an effect without joint or link is on the arm
    dated[["joint", "link"]] = dated[["joint", "link"]].fillna(0).astype(int)
    made = []
    factors = {}
    # angles come round again, and without a deviation nothing can be tested
    known = dated[(dated["std"] > 0) & ~dated["parameter"].isin(ANGLES)]
    names = [*UNIT, *NUMBER, "si_unit"]
    # how much deviations understate is common to all units
    for parameter, of_parameter in known.groupby(["effect", "parameter"]):
        own = []
        for key, rows in of_parameter.groupby(names):
            values = rows["value"].to_numpy(float)
            # the error of the effect's form is part of the deviations, as between units
            form = EFFECT_FORM * np.abs(values).mean()
            stds = np.hypot(rows["std"].to_numpy(float), form)
            named = dict(zip(names, key, strict=True))
            own.append((History(named, rows[KEPT], values), stds))
        factor = scatter([(one.values, stds) for one, stds in own])
        factors[parameter] = factor
        made += [replace(one, stds=factor * stds) for one, stds in own]
    # whether each effect of a unit was found in its diagnoses
    of_unit = dict(iter(cases.sort_values(IN_TIME, kind="stable").groupby(UNIT)))
    # the key begins with unit and nominal arm
    for key, group in dated.groupby([*UNIT, *PLACE]):
        rows = of_unit[key[:2]]
        found = rows["result"].isin(group["result"]).to_numpy(float)
        # found every time: neither appeared nor vanished
        if not found.all():
            named = dict(zip(names, (*key, "", "", ""), strict=True))
            made.append(History(named, rows[KEPT], found))
    return [one for one in made if len(one.values) >= SHORTEST_HISTORY], factors


# The units of one type of robot compared: which effects they share, and which unit stands out.


EXTREMES = 5
"""Units that are listed as the farthest from the common value, at most [1]."""


def _on_units(effects: pd.DataFrame, units: int) -> list[Document]:
    """Effects of the last diagnoses of several units; see ``gapscope.diagnosis.compare_units``.

    Args:
        effects: numbers of the named effects, of one diagnosis a unit.
        units: number of units that were diagnosed.

    Returns:
        An entry of ``fleet.json`` for each effect on each place: those on all units first, then the most frequent.
    """
    numbers = []
    for row in effects.to_dict("records"):
        joint, link = (None if pd.isna(row[k]) else int(row[k]) for k in PLACE[1:])
        names = row["parameter"], row["component"], row["si_unit"]
        # zero stands for a deviation that is not known
        std = row["std"] if row["std"] > 0 else None
        number = Number(row["effect"], joint, link, *names, row["value"], std)
        numbers.append((row["unit"], number, row["share"]))
    made = []
    for row in shared_effects(numbers, units):
        parameters = [
            {key: parameter[key] for key in ("name", "component", "unit", "together")}
            | {"extremes": list(_extremes(parameter))}
            for parameter in row["parameters"]
        ]
        # one share for all units: their median
        shares = list(row.pop("shares").values())
        row |= {"units": len(shares), "share": np.median(shares)}
        made.append({**row, "parameters": parameters})
    return sorted(made, key=lambda row: (ORDER.index(row["kind"]), -row["units"]))


def _extremes(parameter: Document) -> Iterator[Document]:
    """The units farthest from the common value, in standard deviations of a single unit."""
    together = parameter["together"]
    # a single unit has no others to be far from
    if together is None:
        return
    units = list(parameter["value"])
    values = np.array(list(parameter["value"].values()))
    stds = np.array([std or 0.0 for std in parameter["std"].values()])
    spread = np.hypot(stds, together["between"])
    # without any scatter no unit is far from the others
    spread = np.where(spread > 0, spread, np.inf)
    deviation = (values - together["estimate"]) / spread
    for k in np.argsort(-np.abs(deviation), kind="stable")[:EXTREMES]:
        yield {
            "unit": units[k],
            "value": values[k],
            "std": parameter["std"][units[k]],
            "deviation": deviation[k],
        }


# The fleet as data: ``fleet.json``.


MOST = 200
"""Entries of a list: the first of units, changes and failures are enough to act on; Parquet has all [1]."""
FAILURE = ["case", "unit", "date", "error", "tries"]


def fleet_document(store: FleetStore) -> dict[str, Any]:
    """Compare what a store holds, one type of robot after the other, so that no more is in memory.

    Raises:
        InputError: the store has no results, or they cannot be read.
    """
    rows = store.cases()
    failed, cases = rows[rows["error"] != ""], rows[rows["error"] == ""]
    # only arms of one type are compared
    cases = cases.assign(type=cases["robot"] + "\0" + cases["joints"].map(" ".join))
    everything = []
    robots, factors = [], []
    for _, of_type in cases.groupby("type"):
        robot = of_type["robot"].iloc[0]
        effects = store.effects(robot, of_type["result"])
        named = effects[effects["named"].astype(bool)]
        found, scatter = histories(of_type, named)
        everything += found
        # one diagnosis of each: a unit that is recorded daily counts as one
        last = _latest(of_type)
        of_last = named[named["result"].isin(last["result"])]
        robots.append(
            {
                "robot": robot,
                "joints": of_type["joints"].iloc[0],
                "cases": len(of_type),
                "units": len(last),
                "nominal_arms": last["nominal_sha256"].nunique(),
                "effects": _on_units(of_last, len(last))[:MOST],
            }
        )
        factors += [
            {"robot": robot, "effect": effect, "parameter": name, "factor": factor}
            for (effect, name), factor in scatter.items()
        ]
    # of the whole fleet at once: of the histories called changed a share is not, on average [benjamini1995]
    p = np.array([history.first.p for history in everything])
    chosen = false_discovery_control(p) <= FALSE_CHANGES if len(p) else p > 0
    # the largest p among them: the level at which the parts before and after a change are tested again
    level = float(p[chosen].max(initial=0.0))
    clear = (everything[k].changes(level) for k in np.flatnonzero(chosen))
    changes = sorted(chain.from_iterable(clear), key=lambda change: change["p"])
    content = {
        "schema": 1,
        "cases": len(rows),
        "failed": len(failed),
        "units": sum(robot["units"] for robot in robots),
        "recorded_hours": cases["recorded_seconds"].sum() / 3600,
        "processor_hours": rows["processor_seconds"].sum() / 3600,
        "robots": robots,
        "histories": len(everything),
        "false_share": FALSE_CHANGES,
        "scatter": factors,
        "changes": changes[:MOST],
        "changes_in_all": len(changes),
        # a unit may change in several effects, and counts once
        "units_changed": len({change["unit"] for change in changes}),
        "worst": _worst(_latest(cases), changes),
        "failures": failed[FAILURE].head(MOST).to_dict("records"),
    }
    document = plain(content, null_if_not_finite=True)
    error = schema_fault(document, "fleet")
    if error is not None:
        raise error
    return document


def _latest(cases: pd.DataFrame) -> pd.DataFrame:
    """The last diagnosis of each unit of each type of robot."""
    in_time = cases.sort_values(IN_TIME, kind="stable")
    return in_time.drop_duplicates(["robot", "unit"], keep="last")


def _worst(last: pd.DataFrame, changes: list[Document]) -> list[Document]:
    """The last diagnoses, those with the largest gap over the floor first."""
    # of all changes, those beyond the listed ones too
    units = [change["unit"] for change in changes]
    counts = pd.Series(units, dtype=object).value_counts()
    order = last.sort_values(["excess", "unit"], ascending=[False, True]).head(MOST)
    keys = ["unit", "robot", "case", "date", "verdict", "gap", "excess", "left"]
    return [
        {
            **row,
            "effects": np.atleast_1d(row["effects"]),
            "changes": counts.get(row["unit"], 0),
        }
        for row in order[[*keys, "closed", "kept", "effects"]].to_dict("records")
    ]
