"""The ranges that diagnoses leave open: intervals of one unit, and the spread between units of one type."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.effect_ranges import EffectRange, EffectRanges

Z95 = 1.96
"""Half the width of a 95 % interval of a normal distribution [standard deviations]."""
TOTALS = {
    "coulomb_friction": "coulomb",
    "viscous_friction": "viscous",
    "armature": "armature",
}
"""Effects whose value adds to one of the data sheet, with which it may not be negative."""
BOUND_TO_RECORDING = ("external_force",)
"""Effects that belong to the recording in which they acted."""


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
    by_unit = [{item.key: item for item in unit} for unit in units]
    keys = dict.fromkeys(key for unit in by_unit for key in unit)
    return tuple(
        _hull([unit[key] for unit in by_unit if key in unit], len(by_unit))
        for key in keys
        if key[0] not in BOUND_TO_RECORDING
    )


def within_nominal(ranges: Iterable[EffectRange], arm: NominalArm) -> EffectRanges:
    """The ranges without values at which friction or armature would be negative, the data sheet's included."""
    kept = []
    for item in ranges:
        sheet = TOTALS.get(item.low.name)
        if sheet is not None:
            joints = np.array(item.low.joints) - 1
            least = -getattr(arm, sheet)[joints]
            low, high = (_raised(end, least) for end in (item.low, item.high))
            item = EffectRange(low, high)
        kept.append(item)
    return EffectRanges(tuple(kept))


def _hull(items: list[EffectRange], units: int) -> EffectRange:
    """The range that holds all of some ranges of an effect, of so many units."""
    effect = items[0].low.name
    joints = tuple(sorted({joint for item in items for joint in item.low.joints}))
    low, high = {}, {}
    for parameter in items[0].low.effect.parameters:
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
        AppliedEffect(effect, joints, low), AppliedEffect(effect, joints, high)
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


def _raised(applied: AppliedEffect, least: np.ndarray) -> AppliedEffect:
    """The effect with its values raised to the least possible ones, shape (m,)."""
    raised = {name: np.maximum(v, least) for name, v in applied.parameters.items()}
    return AppliedEffect(applied.name, applied.joints, raised)
