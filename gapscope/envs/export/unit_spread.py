"""The ranges that diagnoses leave open: intervals of one unit, and the spread between units of one type."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.effect import SHEET, External
from gapscope.envs.effect_ranges import EffectRange, EffectRanges

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
            for p in applied.effect.parameters
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
    joints = tuple(sorted({joint for item in items for joint in item.low.joints}))
    low, high = {}, {}
    for parameter in effect.parameters:
        name = parameter.name
        # an effect that is absent has this value, or none
        absent = 0.0 if parameter.severity == 1 else np.nan
        lows = [_on(item.low, name, joints, absent) for item in items]
        highs = [_on(item.high, name, joints, absent) for item in items]
        if len(items) < units:
            without = np.full(lows[0].shape, absent)
            lows.append(without)
            highs.append(without)
        low[name], high[name] = np.nanmin(lows, axis=0), np.nanmax(highs, axis=0)
    return EffectRange(
        AppliedEffect(effect.name, joints, low),
        AppliedEffect(effect.name, joints, high),
    )


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
        if quantity in SHEET:
            least = -getattr(arm, SHEET[quantity])[rows]
            values[name] = np.maximum(values[name], least)
    return AppliedEffect(applied.name, applied.joints, values)
