"""Effects that several units of one type of arm share, and effects of one of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import pi
from typing import Any, NamedTuple

import numpy as np

from gapscope.diagnosis.fleet.heterogeneity import Pooled, pooled
from gapscope.diagnosis.thresholds import FLEET_LEVEL

ANGLES = ("phase",)
"""Parameters that repeat after a full turn, of which a share means nothing."""
SHARED, DIFFERING, SOME, ONE = (
    "shared",
    "shared_differing_size",
    "some_units",
    "one_unit",
)
ORDER = (SHARED, DIFFERING, SOME, ONE)

Document = Mapping[str, Any]


@dataclass(frozen=True)
class SharedParameter:
    """One number of an effect on one place, on the units on which the effect was found.

    Attributes:
        name: name of the parameter.
        component: ``x``, ``y`` or ``z`` of a vector, else empty.
        unit: its SI unit.
        values: by unit of the arm.
        stds: their standard deviations, ``None`` if not known.
        pooled: all units taken together; ``None`` if there is one.
    """

    name: str
    component: str
    unit: str
    values: Mapping[str, float]
    stds: Mapping[str, float | None]
    pooled: Pooled | None


@dataclass(frozen=True)
class SharedEffect:
    """An effect on one place, and on which units it was found.

    Attributes:
        effect: name of the effect.
        joint: from 1; ``None`` for effects on a link or the arm.
        link: of a changed link, from 1; else ``None``.
        kind: ``shared``: on all units, values agree; ``shared_differing_size``: on all units, values differ;
            ``some_units``: on two or more, not on all; ``one_unit``.
        units: on which it was found.
        shares: of each unit's gap [1].
        agree: whether the values agree; ``None`` if there is one unit.
        instead: units without it if an effect was found of which it is an alternative, and that effect.
        values: its numbers.
    """

    effect: str
    joint: int | None
    link: int | None
    kind: str
    units: tuple[str, ...]
    shares: Mapping[str, float]
    agree: bool | None
    instead: Mapping[str, str]
    values: tuple[SharedParameter, ...]


def groups(
    documents: Mapping[str, Document],
) -> dict[tuple[str, tuple[str, ...]], dict[str, Document]]:
    """Diagnoses by robot and joints: only arms of one type are compared."""
    found: dict[tuple[str, tuple[str, ...]], dict[str, Document]] = {}
    for unit, document in documents.items():
        if "arm" in document:
            arm = document["arm"]
            found.setdefault((arm["robot"], tuple(arm["joints"])), {})[unit] = document
    return found


def compare(documents: Mapping[str, Document]) -> tuple[SharedEffect, ...]:
    """Compare the diagnoses of units of one type of arm.

    Args:
        documents: content of ``diagnosis.json`` by name of the unit; two or more.

    Returns:
        Each effect on each place; those on all units first, the largest share first among equals.
    """
    found: dict[tuple[str, int, int], dict[str, _Found]] = {}
    for unit, document in documents.items():
        for entry in document["effects"]:
            for position, (joint, link) in enumerate(_places(entry)):
                by_unit = found.setdefault((entry["effect"], joint, link), {})
                by_unit[unit] = _Found(entry, position)
    rows = [_shared(*key, entries, documents) for key, entries in found.items()]
    return tuple(sorted(rows, key=_rank))


def _rank(row: SharedEffect) -> tuple[int, float, int]:
    """Effects on all units first, then the largest share."""
    return ORDER.index(row.kind), -max(row.shares.values()), row.joint or 0


def _places(entry: Document) -> list[tuple[int, int]]:
    """Pairs of joint and link on which an entry acts, 0 if it does not act on one."""
    if entry["joints"]:
        return [(joint, 0) for joint in entry["joints"]]
    link = entry["parameters"].get("link")
    return [(0, int(link["value"]) if link else 0)]


class _Found(NamedTuple):
    """An effect on one place of one unit: its entry in the diagnosis, and the place's position in the entry."""

    entry: Document
    position: int


def _shared(
    effect: str,
    joint: int,
    link: int,
    entries: Mapping[str, _Found],
    documents: Mapping[str, Document],
) -> SharedEffect:
    """One effect on one place of the units that have it."""
    values = tuple(_values(entries))
    together = [value.pooled for value in values]
    agree = units_agree(together) if len(entries) > 1 else None
    instead = {}
    for unit, document in documents.items():
        other = None if unit in entries else _instead(document, effect, joint)
        if other:
            instead[unit] = other
    return SharedEffect(
        effect,
        joint or None,
        link or None,
        kind_of(agree, on_all=len(entries) == len(documents)),
        tuple(entries),
        {unit: float(found.entry["share"]) for unit, found in entries.items()},
        agree,
        instead,
        values,
    )


def units_agree(values: Sequence[Pooled | None]) -> bool:
    """Whether no value differs between the units; the level is divided by the number of values tested."""
    level = FLEET_LEVEL / max(len(values), 1)
    return all(value is None or value.p >= level for value in values)


def kind_of(agree: bool | None, *, on_all: bool) -> str:
    """The kind of an effect; ``agree`` is ``None`` if one unit has it."""
    if agree is None:
        return ONE
    if not on_all:
        return SOME
    return SHARED if agree else DIFFERING


def _instead(document: Document, effect: str, joint: int) -> str | None:
    """Effect found on the place of which the one asked for is an alternative."""
    for entry in document["effects"]:
        here = joint in entry["joints"] if joint else not entry["joints"]
        if here and any(other["effect"] == effect for other in entry["alternatives"]):
            return str(entry["effect"])
    return None


def _values(entries: Mapping[str, _Found]) -> Iterable[SharedParameter]:
    """The numbers of an effect on one place; those that only some of the units have are left out."""
    first = next(iter(entries.values())).entry
    for name, parameter in first["parameters"].items():
        on_all = all(name in found.entry["parameters"] for found in entries.values())
        if name == "link" or not on_all:
            continue
        values_of, stds_of = {}, {}
        for unit, found in entries.items():
            values_of[unit], stds_of[unit] = _numbers(found, name)
        count = min(len(values) for values in values_of.values())
        for i in range(count):
            values = {unit: float(numbers[i]) for unit, numbers in values_of.items()}
            stds = {unit: numbers[i] for unit, numbers in stds_of.items()}
            yield SharedParameter(
                name,
                "xyz"[i] if count == 3 else "",
                parameter["unit"],
                values,
                stds,
                pooled_parameter(name, list(values.values()), list(stds.values())),
            )


def pooled_parameter(
    name: str, values: Sequence[float], stds: Sequence[float | None]
) -> Pooled | None:
    """The values of all units taken together; ``None`` for one unit."""
    if len(values) < 2:
        return None
    if name in ANGLES:
        # a share of an angle means nothing, so that no error of form is added
        return pooled(_same_turn(values), stds, form=0.0)
    return pooled(values, stds)


def _numbers(
    found: _Found, name: str
) -> tuple[Sequence[float], Sequence[float | None]]:
    """Values and deviations of a parameter on one place: one number, or the components of a vector."""
    entry, position = found
    value, std = entry["parameters"][name]["value"], entry["parameters"][name]["std"]
    if entry["joints"]:
        return [value[position]], [None if std is None else std[position]]
    if isinstance(value, list):
        return value, [None] * len(value) if std is None else std
    return [value], [std]


def _same_turn(angles: Sequence[float]) -> list[float]:
    """Angles [rad] within half a turn of the first."""
    first = angles[0]
    return [float(first + np.remainder(a - first + pi, 2 * pi) - pi) for a in angles]
