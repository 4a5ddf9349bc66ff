"""Localisation in depth of the gap of some joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.localisation.frequencies import coherent, line
from gapscope.diagnosis.localisation.region import Region
from gapscope.diagnosis.localisation.rule import rule
from gapscope.diagnosis.localisation.rule_variables import quantities
from gapscope.diagnosis.localisation.spectra import Spectra, spectra
from gapscope.diagnosis.localisation.stacked_rows import Rows
from gapscope.diagnosis.localisation.time_intervals import Levels, intervals, levels
from gapscope.diagnosis.thresholds import REGIONS_PER_JOINT

BINS = 24
"""Bins of the quantity of a rule in ``Place.profile``."""


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
class Place:
    """Where the gap of one joint lies.

    Attributes:
        joint: from 1.
        floor: RMS that a healthy arm leaves [N m].
        regions: what is said of it.
        profile: of the rule's first quantity with a scale; ``None`` if there is no rule.
        levels: level over time, one per recording.
        spectra: of the gap and of the joint's own signals.
    """

    joint: int
    floor: float
    regions: tuple[Region, ...]
    profile: Profile | None
    levels: tuple[Levels, ...]
    spectra: Spectra


def locate(
    error: np.ndarray,
    rows: Rows,
    load: np.ndarray,
    floor: np.ndarray,
    joints: list[int],
) -> list[Place]:
    """Rules, intervals, lines and bands of the gap of some joints.

    Args:
        error: gap [N m], (M, n).
        rows: motion of the same rows.
        load: torque that the nominal arm predicts [N m], (M, n).
        floor: RMS that a healthy arm leaves [N m], (n,).
        joints: from 1; a joint whose gap is zero is left out.
    """
    return [
        _place(error[:, j - 1], rows, load, float(floor[j - 1]), j)
        for j in joints
        if error[:, j - 1].any()
    ]


def _place(
    error: np.ndarray, rows: Rows, load: np.ndarray, floor: float, joint: int
) -> Place:
    own = rule(error, rows, load, floor, joint)
    over_time = levels(error, rows, floor)
    bursts = intervals(over_time, joint)[:REGIONS_PER_JOINT]
    if (
        own is not None
        and bursts
        and any(c["quantity"] == "time" for c in own.detail["conditions"])
    ):
        own = None  # the intervals say it better: they know which recording
    in_frequency = spectra(error, rows, load, joint)
    peak = line(in_frequency, joint)
    found = [own, *bursts, peak, *coherent(in_frequency, joint)[:REGIONS_PER_JOINT]]
    regions = tuple(region for region in found if region is not None)
    return Place(
        joint,
        floor,
        regions,
        _profile(own, error, rows, load, joint),
        tuple(over_time),
        in_frequency,
    )


def _profile(
    own: Region | None, error: np.ndarray, rows: Rows, load: np.ndarray, joint: int
) -> Profile | None:
    """RMS over bins of equal width between the outer percentiles of the rule's first quantity with a scale."""
    conditions = (
        [] if own is None else [c for c in own.detail["conditions"] if c["unit"]]
    )
    if own is None or not conditions:
        return None
    first = conditions[0]
    values = next(
        q.values
        for q in quantities(rows, load, joint - 1)
        if q.name == first["quantity"]
    )
    low, high = np.percentile(values, [0.5, 99.5])
    edges = np.linspace(low, high, BINS + 1)
    place = np.clip(np.digitize(values, edges) - 1, 0, BINS - 1)
    count = np.bincount(place, minlength=BINS)
    rms = np.sqrt(np.bincount(place, error**2, minlength=BINS) / np.maximum(count, 1))
    kept = count > 0
    middle = (edges[:-1] + edges[1:]) / 2
    return Profile(
        first["symbol"],
        first["unit"],
        middle[kept],
        rms[kept],
        first["above"],
        first["below"],
        own.regime,
    )
