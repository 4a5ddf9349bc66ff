"""Localisation in depth of the gap of some joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.localisation.frequencies import coherent, line
from gapscope.diagnosis.localisation.region import Region
from gapscope.diagnosis.localisation.rule import rule
from gapscope.diagnosis.localisation.rule_variables import rule_variables
from gapscope.diagnosis.localisation.spectra import Spectra, spectra
from gapscope.diagnosis.localisation.stacked_rows import MotionRows
from gapscope.diagnosis.localisation.time_intervals import GapLevels, intervals, levels
from gapscope.diagnosis.thresholds import REGIONS_PER_JOINT

BINS = 24
"""Bins of the quantity of a rule in ``JointLocalisation.profile``."""


@dataclass(frozen=True)
class Profile:
    """RMS of a gap over bins of one quantity.

    Attributes:
        symbol, unit: of the quantity.
        x: middle of the bins, (B,).
        rms: RMS of the gap in each [N m], (B,).
        above, below: the rule's bounds on the quantity; ``None`` if open.
        words: the whole rule.
    """

    symbol: str
    unit: str
    x: np.ndarray
    rms: np.ndarray
    above: float | None
    below: float | None
    words: str


@dataclass(frozen=True)
class JointLocalisation:
    """Where the gap of one joint lies.

    Attributes:
        joint: from 1.
        floor: RMS that a healthy arm leaves [N m].
        regions: in which the gap lies.
        profile: of the rule's first quantity with a scale; ``None`` if there is no rule.
        levels: level over time, one per recording.
        spectra: of the gap and of the joint's own signals.
    """

    joint: int
    floor: float
    regions: tuple[Region, ...]
    profile: Profile | None
    levels: tuple[GapLevels, ...]
    spectra: Spectra


def locate(
    error: np.ndarray,
    rows: MotionRows,
    load: np.ndarray,
    floor: np.ndarray,
    joints: list[int],
) -> list[JointLocalisation]:
    """Rules, intervals, lines and bands of the gap of some joints.

    Args:
        error: gap [N m], (M, n).
        rows: motion of the same rows.
        load: torque that the nominal arm predicts [N m], (M, n).
        floor: RMS that a healthy arm leaves [N m], (n,).
        joints: from 1; a joint whose gap is zero is left out.
    """
    return [
        _localised(error[:, j - 1], rows, load, float(floor[j - 1]), j)
        for j in joints
        if error[:, j - 1].any()
    ]


def _localised(
    error: np.ndarray, rows: MotionRows, load: np.ndarray, floor: float, joint: int
) -> JointLocalisation:
    """Where the gap of one joint (M,) lies."""
    over_time = levels(error, rows, floor)
    bursts = intervals(over_time, joint)[:REGIONS_PER_JOINT]
    own_rule = rule(error, rows, load, floor, joint)
    # Intervals say more than a rule over time: they know which recording.
    if own_rule is not None and bursts and _is_over_time(own_rule):
        own_rule = None
    in_frequency = spectra(error, rows, load, joint)
    bands = coherent(in_frequency, joint)[:REGIONS_PER_JOINT]
    found = [own_rule, *bursts, line(in_frequency, joint), *bands]
    return JointLocalisation(
        joint,
        floor,
        tuple(region for region in found if region is not None),
        _profile(own_rule, error, rows, load, joint),
        tuple(over_time),
        in_frequency,
    )


def _is_over_time(region: Region) -> bool:
    """Whether a rule has a condition on time."""
    conditions = region.detail["conditions"]
    return any(condition["quantity"] == "time" for condition in conditions)


def _profile(
    own_rule: Region | None,
    error: np.ndarray,
    rows: MotionRows,
    load: np.ndarray,
    joint: int,
) -> Profile | None:
    """RMS over bins of equal width between the outer percentiles of the rule's first quantity with a scale."""
    if own_rule is None:
        return None
    conditions = [c for c in own_rule.detail["conditions"] if c["unit"]]
    if not conditions:
        return None
    first = conditions[0]
    variables = {v.name: v.values for v in rule_variables(rows, load, joint - 1)}
    values = variables[first["quantity"]]
    low, high = np.percentile(values, [0.5, 99.5])
    edges = np.linspace(low, high, BINS + 1)
    index = np.clip(np.digitize(values, edges) - 1, 0, BINS - 1)
    count = np.bincount(index, minlength=BINS)
    square = np.bincount(index, error**2, minlength=BINS)
    used = count > 0
    middle = (edges[:-1] + edges[1:]) / 2
    return Profile(
        first["symbol"],
        first["unit"],
        middle[used],
        np.sqrt(square[used] / count[used]),
        first["above"],
        first["below"],
        own_rule.regime,
    )
