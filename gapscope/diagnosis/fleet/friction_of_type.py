"""One law of friction for a type of robot, unless a unit shows otherwise.

Units of one design rub alike, by different amounts. Where each of them has friction on a joint, but by different laws,
most of them tell the law; the others are asked again without what they have in its place, and keep their own where that
explains more.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from gapscope.diagnosis.fleet.compare_units import groups
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.effect import TorqueLaw

FEWEST = 3
"""Of two units neither has the law of the type. (definition)"""
EXPLAINS_MORE = 0.01
"""A law explains more if another leaves so much more of a joint's torque [1]: what an effect closes that is named."""

Document = Mapping[str, Any]


def other_laws(documents: Mapping[str, Document]) -> dict[str, tuple[str, ...]]:
    """Laws of friction that units have in the place of those of their type, by the unit.

    Args:
        documents: content of ``diagnosis.json`` by name of the unit.
    """
    out: dict[str, tuple[str, ...]] = {}
    for members in groups(documents).values():
        if len(members) >= FEWEST:
            out |= _other_laws(members)
    return out


def _other_laws(members: Mapping[str, Document]) -> dict[str, tuple[str, ...]]:
    """The same of the units of one type."""
    own = {unit: _laws(document) for unit, document in members.items()}
    # joints on which all of them have friction
    joints = set.intersection(*(set(laws) for laws in own.values()))
    common: set[str] = set()
    apart: dict[str, set[str]] = {unit: set() for unit in members}
    for joint in sorted(joints):
        counts = Counter(laws[joint] for laws in own.values())
        (most, number), *others = counts.most_common()
        common |= most
        if others and number > others[0][1]:
            for unit, laws in own.items():
                apart[unit] |= laws[joint] - most
    # a law that the type has on another joint cannot be left out
    kept = {unit: tuple(sorted(names - common)) for unit, names in apart.items()}
    return {unit: names for unit, names in kept.items() if names}


def _laws(document: Document) -> dict[int, frozenset[str]]:
    """Names of the laws of friction by joint, of those on which there are any."""
    found: dict[int, set[str]] = {}
    for entry in document["effects"]:
        effect = CATALOGUE.get(entry["effect"])
        if isinstance(effect, TorqueLaw) and effect.family == "friction":
            for joint in entry["joints"]:
                found.setdefault(joint, set()).add(effect.name)
    return {joint: frozenset(names) for joint, names in found.items()}


def explains_as_much(asked: Document, before: Document) -> bool:
    """Whether a diagnosis with the law of the type leaves no more of any joint's torque than that with a unit's own."""
    if asked["verdict"] != before["verdict"]:
        return False
    left, least = (
        np.array(document["gap"]["after"]["torque_nrmse"], dtype=float)
        for document in (asked, before)
    )
    return bool((left <= least + EXPLAINS_MORE).all())
