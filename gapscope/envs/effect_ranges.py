"""Effects between two ends, all drawn anew at a reset; as a file, and as diagnoses leave them open."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.case_file import read_yaml
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected_file import read_entry
from gapscope.effects.effect import SHEET, External


class EffectRange(NamedTuple):
    """An effect of which each parameter lies between two ends, independently of the others.

    Attributes:
        low, high: the effect with its lower and upper values; same name, same joints.
    """

    low: AppliedEffect
    high: AppliedEffect

    @property
    def key(self) -> tuple[str, int]:
        """Name of the effect, and the link that it changes, 0 without one."""
        return self.low.key

    def draw(self, rng: np.random.Generator) -> AppliedEffect:
        """The effect with each value drawn evenly between its ends."""
        ends = zip(
            self.low.parameters.items(), self.high.parameters.values(), strict=True
        )
        drawn = {name: rng.uniform(low, high) for (name, low), high in ends}
        return AppliedEffect(self.low.name, self.low.joints, drawn)


class EffectRanges(NamedTuple):
    """Effects that are all drawn at a reset, each within its range.

    Attributes:
        ranges: at most one of an effect on a joint, a link or the arm.
    """

    ranges: tuple[EffectRange, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(item.low.name for item in self.ranges)

    def draw(self, rng: np.random.Generator) -> tuple[AppliedEffect, ...]:
        """The effects with values; the same state of ``rng`` gives the same, bit by bit."""
        return tuple(item.draw(rng) for item in self.ranges)


def write_effect_ranges(ranges: EffectRanges, path: Path, head: str = "") -> None:
    """Write ranges as YAML; ``path`` never holds half of it.

    Raises:
        GapscopeError: the file cannot be written.
    """
    content = {"schema": 1, "ranges": [_entry(item) for item in ranges.ranges]}
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    with atomic_write(path) as aside:
        aside.write_text(head + text, encoding="utf-8")


def read_effect_ranges(path: Path | str) -> EffectRanges:
    """Ranges from a file of ``gapscope export --format environment``.

    Raises:
        InputError: the file is missing or not YAML, or an entry is not an effect with ``low`` and ``high``.
    """
    path = Path(path)
    content = read_yaml(path, "check the path")
    entries = content.get("ranges") if isinstance(content, Mapping) else None
    if not isinstance(entries, list):
        raise InputError(
            "expected the keys schema: 1 and ranges: [...]",
            "gapscope export --format environment --randomise writes such a file",
            file=path,
        )
    found = [_read(entry, f"ranges[{i}]", path) for i, entry in enumerate(entries)]
    return EffectRanges(tuple(found))


def _read(entry: Any, where: str, path: Path) -> EffectRange:
    """A range from its entry."""
    if not isinstance(entry, Mapping) or not {"low", "high"} <= set(entry):
        raise InputError(
            "expected effect:, joints:, low: and high:", file=path, where=where
        )
    # joints and name are said once, each end has its own parameters
    rest = {name: entry[name] for name in ("effect", "joints") if name in entry}
    low, high = (
        read_entry(rest | {"parameters": entry[end]}, f"{where}.{end}", path)
        for end in ("low", "high")
    )
    for name, value in low.parameters.items():
        if (value > high.parameters[name]).any():
            raise InputError(
                f"{name} is higher in low: than in high:",
                "give the lower value in low:",
                file=path,
                where=where,
            )
    return EffectRange(low, high)


def _entry(item: EffectRange) -> dict[str, Any]:
    # what was not given stays at its default when it is read again
    low, high = (
        {name: end.parameters[name].tolist() for name in end.given}
        for end in (item.low, item.high)
    )
    joints = {"joints": list(item.low.joints)} if item.low.joints else {}
    return {"effect": item.low.name, **joints, "low": low, "high": high}


Z95 = 1.96
"""Half the width of a 95 % interval of a normal distribution [standard deviations]."""


def effect_range(applied: AppliedEffect, std: Mapping[str, np.ndarray]) -> EffectRange:
    """The 95 % interval of an effect: value +- 1.96 standard deviations, within the bounds of the catalogue.

    Args:
        applied: the effect with its values.
        std: standard deviation of each parameter, in its unit and shape.
    """
    ends = []
    for side in (-Z95, Z95):
        moved = {
            p.name: np.clip(applied.parameters[p.name] + side * std[p.name], *p.bounds)
            for p in map(applied.effect.parameter, applied.given)
        }
        ends.append(AppliedEffect(applied.name, applied.joints, moved))
    return EffectRange(*ends)


def spread(units: Sequence[Iterable[EffectRange]]) -> tuple[EffectRange, ...]:
    """The ranges that hold all units: from the lowest end of any to the highest.

    On a unit without an effect its value is zero; what says where, when or how stiff has no such
    value and comes from the units that have the effect.

    Args:
        units: the ranges of each unit.
    """
    # a force from outside belongs to the recording in which it acted
    by_unit = [
        {r.key: r for r in unit if not isinstance(r.low.effect, External)}
        for unit in units
    ]
    # a dict and no set: their order is the same from run to run
    keys = dict.fromkeys(key for unit in by_unit for key in unit)
    return tuple(
        _hull([unit[key] for unit in by_unit if key in unit], len(by_unit))
        for key in keys
    )


def within_nominal(ranges: Iterable[EffectRange], arm: NominalArm) -> EffectRanges:
    """The ranges without values at which friction or armature would be negative, the data sheet's included."""
    return EffectRanges(
        tuple(EffectRange(_raised(r.low, arm), _raised(r.high, arm)) for r in ranges)
    )


def _hull(items: list[EffectRange], units: int) -> EffectRange:
    """The range that holds all of some ranges of an effect, of so many units."""
    effect = items[0].low.effect
    # the same joints in all ranges, with what an absent effect has on the others
    joints = tuple(sorted({joint for item in items for joint in item.low.joints}))
    ends: dict[str, dict[str, np.ndarray]] = {"low": {}, "high": {}}
    for parameter in effect.parameters:
        name = parameter.name
        # an effect that is absent has this value, or none
        absent = 0.0 if parameter.severity == 1 else np.nan
        for side, extreme in (("low", np.nanmin), ("high", np.nanmax)):
            found = [_on(getattr(x, side), name, joints, absent) for x in items]
            # a unit without the effect stretches the range to zero, or says nothing (nan)
            if len(items) < units:
                found.append(np.full(found[0].shape, absent))
            ends[side][name] = extreme(found, axis=0)
    low, high = (AppliedEffect(effect.name, joints, x) for x in ends.values())
    return EffectRange(low, high)


def _on(
    applied: AppliedEffect, name: str, joints: tuple[int, ...], absent: float
) -> np.ndarray:
    """Values of a parameter on these joints, ``absent`` on joints that the effect is not on."""
    value = applied.parameters[name]
    if not joints:
        return value
    known = dict(zip(applied.joints, value.tolist(), strict=True))
    return np.array([known.get(joint, absent) for joint in joints])


def _raised(applied: AppliedEffect, arm: NominalArm) -> AppliedEffect:
    """The effect with what adds to the data sheet raised to where the sum is not negative."""
    rows = np.array(applied.joints, dtype=int) - 1
    values = dict(applied.parameters)
    for name, quantity in applied.effect.quantities.items():
        # what is added may take off no more than the data sheet states
        if quantity in SHEET:
            least = -getattr(arm, SHEET[quantity])[rows]
            values[name] = np.maximum(values[name], least)
    return AppliedEffect(applied.name, applied.joints, values)
