"""When a gap starts and stops: change points of its level over time, by penalised least squares [killick2012]."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gapscope.diagnosis.localisation.region import Region
from gapscope.diagnosis.localisation.stacked_rows import MotionRows
from gapscope.diagnosis.thresholds import (
    CHANGE_POINT_PENALTY,
    INTERVAL_RATIO,
    LEAST_INTERVAL_WINDOWS,
    LEAST_LEVEL_NOISE,
    LEVEL_WINDOW,
    MOST_CHANGE_POINTS,
    MOST_INTERVALS,
    REGION_ENRICHMENT,
    REGION_SHARE,
)


@dataclass(frozen=True)
class GapLevels:
    """Level of a gap over one recording: W windows in S stretches between change points.

    Attributes:
        recording: name, or its number in words.
        t: middle of the windows [s], (W,).
        rms: RMS of the gap in each [N m], (W,).
        edges: windows at which the stretches begin, and the end, (S + 1,).
    """

    recording: str
    t: np.ndarray
    rms: np.ndarray
    edges: tuple[int, ...]

    @property
    def steps(self) -> np.ndarray:
        """RMS over the stretch that each window belongs to [N m], (W,)."""
        stretches = [slice(a, b) for a, b in itertools.pairwise(self.edges)]
        means = [np.sqrt(np.mean(self.rms[stretch] ** 2)) for stretch in stretches]
        return np.repeat(means, np.diff(self.edges))


def levels(error: np.ndarray, rows: MotionRows, floor: float) -> list[GapLevels]:
    """Level of one joint's gap [N m], (M,), over each recording; ``floor`` is what a healthy arm leaves [N m]."""
    names = [rows.recording(segment) for segment in range(len(rows.rates))]
    out = []
    for name in dict.fromkeys(names):
        segments = [segment for segment, other in enumerate(names) if other == name]
        inside = np.isin(rows.segment, segments)
        if inside.any():
            out.append(
                _recording_levels(name, rows.clock[inside], error[inside], floor)
            )
    return out


def _recording_levels(
    name: str, t: np.ndarray, error: np.ndarray, floor: float
) -> GapLevels:
    """Level of a gap [N m], (M,), at times t [s], (M,), of one recording."""
    square = error**2
    window = ((t - t[0]) // LEVEL_WINDOW).astype(int)
    count = np.bincount(window)
    # windows cut short by a gap in the recording are left out
    used = count >= 0.5 * np.median(count[count > 0])
    mean = np.bincount(window, square)[used] / count[used]
    middle = t[0] + LEVEL_WINDOW * (np.flatnonzero(used) + 0.5)
    level = np.log(mean + floor**2 + 1e-12 * square.max() + 1e-300)
    return GapLevels(name, middle, np.sqrt(mean), change_points(level))


def change_points(series: np.ndarray) -> tuple[int, ...]:
    """Windows at which the mean of a series (W,) changes: 0, the change points, W.

    Least sum over the stretches of squared deviations from their mean, plus ``CHANGE_POINT_PENALTY`` var log W for each
    stretch, by dynamic programming with the pruning of [killick2012]; var from the differences of neighbours.
    """
    n = len(series)
    if n < 2 * LEAST_INTERVAL_WINDOWS:
        return (0, n)
    charge = CHANGE_POINT_PENALTY * _noise_of(series) ** 2 * np.log(n)
    sums = np.concatenate([[0.0], np.cumsum(series)])
    squares = np.concatenate([[0.0], np.cumsum(series**2)])
    # cost[end]: least cost of the windows before end; last[end]: where its last stretch begins
    cost, last = np.full(n + 1, np.inf), np.zeros(n + 1, dtype=int)
    cost[0] = -charge
    starts = np.array([0])
    for end in range(LEAST_INTERVAL_WINDOWS, n + 1):
        length = end - starts
        sum_of_stretch = sums[end] - sums[starts]
        deviation = squares[end] - squares[starts] - sum_of_stretch**2 / length
        too_short = length < LEAST_INTERVAL_WINDOWS
        reached = np.where(too_short, np.inf, cost[starts] + deviation)
        cost[end] = reached.min() + charge
        last[end] = starts[int(reached.argmin())]
        # a start that costs more already without the charge of a new stretch stays worse
        keep = too_short | (reached <= cost[end])
        starts = np.append(starts[keep], end - LEAST_INTERVAL_WINDOWS + 1)
    edges = [n]
    while edges[-1] > 0:
        edges.append(int(last[edges[-1]]))
    return tuple(edges[::-1])


def _noise_of(series: np.ndarray) -> float:
    """Standard deviation of a series' noise, from the median step between neighbours (a normal one's is 0.6745)."""
    step = float(np.median(np.abs(np.diff(series))))
    return max(step / (0.6745 * np.sqrt(2)), LEAST_LEVEL_NOISE)


class _Stretch(NamedTuple):
    """A stretch between change points: windows ``begin`` to ``end`` of a level, ``place`` among those of all levels."""

    level: GapLevels
    begin: int
    end: int
    place: slice


def intervals(found: list[GapLevels], joint: int) -> list[Region]:
    """The stretches in which a joint's gap is far above that in the rest of all recordings; the largest first.

    The hottest stretch is tried, then the hottest two: a contact may come twice.
    """
    if not found:
        return []
    square = np.concatenate([level.rms for level in found]) ** 2
    hottest = sorted(
        _stretches(found), key=lambda stretch: -square[stretch.place].mean()
    )
    for count in range(1, min(MOST_INTERVALS, len(hottest)) + 1):
        chosen = hottest[:count]
        if _stand_out(chosen, square):
            regions = [_region(stretch, square, joint) for stretch in chosen]
            return sorted(regions, key=lambda region: -region.share)
    return []


def _stretches(found: list[GapLevels]) -> list[_Stretch]:
    """Stretches of the levels that have few change points; with many, the gap follows the motion and not the time."""
    stretches, first = [], 0
    for level in found:
        if len(level.edges) - 2 <= MOST_CHANGE_POINTS:
            for begin, end in itertools.pairwise(level.edges):
                place = slice(first + begin, first + end)
                stretches.append(_Stretch(level, begin, end, place))
        first += len(level.rms)
    return stretches


def _stand_out(chosen: list[_Stretch], square: np.ndarray) -> bool:
    """Whether stretches hold much of the squared level, (W,), and each is far above what lies outside of them all."""
    outside = np.ones(len(square), dtype=bool)
    for stretch in chosen:
        outside[stretch.place] = False
    if not outside.any():
        return False
    share = float(square[~outside].sum() / max(square.sum(), 1e-300))
    coverage = float((~outside).mean())
    if share < max(REGION_SHARE, REGION_ENRICHMENT * coverage):
        return False
    return all(_is_far_above(square[s.place], square[outside]) for s in chosen)


def _is_far_above(inside: np.ndarray, outside: np.ndarray) -> bool:
    """Whether the squared level in an interval is far above that of any stretch outside of the same length."""
    length = min(len(inside), len(outside))
    elsewhere = np.convolve(outside, np.full(length, 1.0 / length), mode="valid").max()
    return bool(inside.mean() > INTERVAL_RATIO * elsewhere)


def _region(stretch: _Stretch, square: np.ndarray, joint: int) -> Region:
    level = stretch.level
    share = float(square[stretch.place].sum() / square.sum())
    coverage = (stretch.end - stretch.begin) / len(square)
    start = end = None
    if stretch.begin > 0:
        start = float(level.t[stretch.begin] - LEVEL_WINDOW / 2)
    if stretch.end < len(level.t):
        end = float(level.t[stretch.end - 1] + LEVEL_WINDOW / 2)
    detail = {"recording": level.recording, "start": start, "end": end}
    words = _words(level.recording, start, end)
    return Region(joint, "interval", words, share, coverage, detail)


def _words(recording: str, start: float | None, end: float | None) -> str:
    if start is None and end is None:
        return f"all of {recording}"
    if start is None:
        return f"{recording}, until it stops at {end:.1f} s"
    if end is None:
        return f"{recording}, from {start:.1f} s, where it starts, to the end"
    return f"{recording}, starts at {start:.1f} s and stops at {end:.1f} s"
