"""The ranges of effects from the files of one or several diagnoses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.diagnosis.document.diagnosis_json import read_document
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import read_corrected_arm
from gapscope.envs.effect_ranges import (
    EffectRange,
    EffectRanges,
    effect_range,
    spread,
    within_nominal,
)

ROUNDING = 1e-6
"""Relative difference up to which a value is the same in both files [1]."""


def read_ranges(
    corrected: Path, found: CorrectedArm, units: Sequence[Path]
) -> EffectRanges:
    """The 95 % intervals of a diagnosis, or the ranges that hold those of several units.

    Args:
        corrected: the file with the effects; ``diagnosis.json`` is beside it.
        found: the arm with them.
        units: folders of diagnoses of other units of the same type.

    Raises:
        InputError: a diagnosis is missing or not that of its ``corrected.yaml``, or of another arm.
    """
    intervals = [_intervals(corrected, found.effects)]
    for folder in units:
        file = folder / "corrected.yaml"
        other = read_corrected_arm(found.arm, file)
        intervals.append(_intervals(file, other.effects))
    return within_nominal(spread(intervals), found.arm)


def _intervals(
    corrected: Path, effects: tuple[AppliedEffect, ...]
) -> list[EffectRange]:
    """The intervals of the effects of one unit."""
    path = corrected.parent / "diagnosis.json"
    findings = read_document(path)["effects"]
    intervals = []
    for applied in effects:
        same = (f for f in findings if _is_of(f, applied))
        finding = next(same, None)
        if finding is None:
            raise InputError(
                f"has no {applied.name} with the values of {corrected.name}",
                "give the corrected.yaml that gapscope diagnose wrote beside it, unchanged",
                file=path,
                where="effects",
            )
        # what has no standard deviation keeps its value
        stds = {
            p.name: np.nan_to_num(
                np.array(finding["parameters"][p.name]["std"], dtype=float)
            )
            for p in applied.effect.parameters
        }
        intervals.append(effect_range(applied, stds))
    return intervals


def _is_of(finding: Mapping[str, Any], applied: AppliedEffect) -> bool:
    """Whether a finding is that of an effect with its values."""
    if finding["effect"] != applied.name or finding["joints"] != list(applied.joints):
        return False
    return all(
        np.allclose(
            np.array(finding["parameters"][name]["value"], dtype=float),
            value,
            rtol=ROUNDING,
            atol=0.0,
        )
        for name, value in applied.parameters.items()
    )
