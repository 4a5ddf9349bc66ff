"""Effects that several units of one type of arm share, and effects of one of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import pi
from typing import Any

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
class Value:
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
class Shared:
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
    values: tuple[Value, ...]


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


def compare(documents: Mapping[str, Document]) -> tuple[Shared, ...]:
    """Compare the diagnoses of units of one type of arm.

    Args:
        documents: content of ``diagnosis.json`` by name of the unit; two or more.

    Returns:
        Each effect on each place; those on all units first, the largest share first among equals.
    """
    found: dict[tuple[str, int, int], dict[str, tuple[Document, int]]] = {}
    for unit, document in documents.items():
        for entry in document["effects"]:
            for position, place in enumerate(_places(entry)):
                found.setdefault((entry["effect"], *place), {})[unit] = (
                    entry,
                    position,
                )
    rows = [_shared(*key, entries, documents) for key, entries in found.items()]
    return tuple(
        sorted(
            rows,
            key=lambda row: (
                ORDER.index(row.kind),
                -max(row.shares.values()),
                row.joint or 0,
            ),
        )
    )


def _places(entry: Document) -> list[tuple[int, int]]:
    """Pairs of joint and link on which an entry acts, 0 if it does not act on one."""
    link = (
        int(entry["parameters"]["link"]["value"])
        if "link" in entry["parameters"]
        else 0
    )
    return [(joint, 0) for joint in entry["joints"]] or [(0, link)]


def _shared(
    effect: str,
    joint: int,
    link: int,
    entries: Mapping[str, tuple[Document, int]],
    documents: Mapping[str, Document],
) -> Shared:
    values = tuple(_values(entries))
    agree = None
    if len(entries) > 1:
        agree = all(
            v.pooled is None or v.pooled.p >= FLEET_LEVEL / len(values) for v in values
        )
    if len(entries) == len(documents) and agree is not None:
        kind = SHARED if agree else DIFFERING
    else:
        kind = SOME if len(entries) > 1 else ONE
    instead = {
        unit: other
        for unit in documents
        if unit not in entries and (other := _instead(documents[unit], effect, joint))
    }
    shares = {unit: float(entry["share"]) for unit, (entry, _) in entries.items()}
    return Shared(
        effect,
        joint or None,
        link or None,
        kind,
        tuple(entries),
        shares,
        agree,
        instead,
        values,
    )


def _instead(document: Document, effect: str, joint: int) -> str | None:
    """Effect found on the place of which the one asked for is an alternative."""
    for entry in document["effects"]:
        here = joint in entry["joints"] if joint else not entry["joints"]
        if here and any(other["effect"] == effect for other in entry["alternatives"]):
            return str(entry["effect"])
    return None


def _values(entries: Mapping[str, tuple[Document, int]]) -> Iterable[Value]:
    """The numbers of an effect on one place; those that only some of the units have are left out."""
    first = next(iter(entries.values()))[0]
    for name, parameter in first["parameters"].items():
        if name == "link" or any(
            name not in entry["parameters"] for entry, _ in entries.values()
        ):
            continue
        vectors = {
            unit: _numbers(entry, name, position)
            for unit, (entry, position) in entries.items()
        }
        count = min(len(values) for values, _ in vectors.values())
        for i in range(count):
            values = {unit: float(v[i]) for unit, (v, _) in vectors.items()}
            stds = {unit: s[i] for unit, (_, s) in vectors.items()}
            together = None
            if len(entries) > 1:
                numbers = (
                    _same_turn(list(values.values()))
                    if name in ANGLES
                    else list(values.values())
                )
                form = {"form": 0.0} if name in ANGLES else {}
                together = pooled(numbers, list(stds.values()), **form)
            yield Value(
                name,
                "xyz"[i] if count == 3 else "",
                parameter["unit"],
                values,
                stds,
                together,
            )


def _numbers(
    entry: Document, name: str, position: int
) -> tuple[Sequence[float], Sequence[float | None]]:
    """Values and deviations of a parameter on one place: one number, or the components of a vector."""
    value, std = entry["parameters"][name]["value"], entry["parameters"][name]["std"]
    if entry["joints"]:
        return [value[position]], [None if std is None else std[position]]
    if isinstance(value, list):
        return value, [None] * len(value) if std is None else std
    return [value], [std]


def _same_turn(angles: Sequence[float]) -> list[float]:
    """Angles [rad] within half a turn of the first."""
    return [
        float(angles[0] + np.remainder(a - angles[0] + pi, 2 * pi) - pi) for a in angles
    ]
