"""When a gap starts and stops: change points of its level over time, by penalised least squares [killick2012]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.localisation.region import Region
from gapscope.diagnosis.localisation.stacked_rows import Rows
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
class Levels:
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
        pairs = zip(self.edges, self.edges[1:], strict=False)
        return np.concatenate(
            [np.full(b - a, np.sqrt(np.mean(self.rms[a:b] ** 2))) for a, b in pairs]
        )


def levels(error: np.ndarray, rows: Rows, floor: float) -> list[Levels]:
    """Level of one joint's gap [N m], (M,), over each recording; ``floor`` is what a healthy arm leaves [N m]."""
    out = []
    for name in dict.fromkeys(rows.recording(s) for s in range(len(rows.rates))):
        mine = np.isin(
            rows.segment,
            [s for s in range(len(rows.rates)) if rows.recording(s) == name],
        )
        t, square = rows.clock[mine], error[mine] ** 2
        if not len(t):
            continue
        window = ((t - t[0]) // LEVEL_WINDOW).astype(int)
        count = np.bincount(window)
        used = count >= 0.5 * np.median(count[count > 0])
        mean = np.bincount(window, square)[used] / count[used]
        middle = t[0] + LEVEL_WINDOW * (np.flatnonzero(used) + 0.5)
        edges = change_points(np.log(mean + floor**2 + 1e-12 * square.max() + 1e-300))
        out.append(Levels(name, middle, np.sqrt(mean), edges))
    return out


def change_points(series: np.ndarray) -> tuple[int, ...]:
    """Where the mean of a series (W,) changes: 0, the change points, W.

    Least sum over the stretches of squared deviations from their mean, plus ``CHANGE_POINT_PENALTY`` var log W for each
    stretch, by dynamic programming with the pruning of [killick2012]; var from the differences of neighbours.
    """
    n = len(series)
    if n < 2 * LEAST_INTERVAL_WINDOWS:
        return (0, n)
    spread = max(
        float(np.median(np.abs(np.diff(series)))) / (0.6745 * np.sqrt(2)),
        LEAST_LEVEL_NOISE,
    )
    charge = CHANGE_POINT_PENALTY * spread**2 * np.log(n)
    total, squares = (
        np.concatenate([[0.0], np.cumsum(x)]) for x in (series, series**2)
    )
    cost, last = np.full(n + 1, np.inf), np.zeros(n + 1, dtype=int)
    cost[0] = -charge
    open_starts = np.array([0])
    for end in range(LEAST_INTERVAL_WINDOWS, n + 1):
        length = end - open_starts
        deviation = (
            squares[end]
            - squares[open_starts]
            - (total[end] - total[open_starts]) ** 2 / length
        )
        reached = np.where(
            length >= LEAST_INTERVAL_WINDOWS, cost[open_starts] + deviation, np.inf
        )
        cost[end], last[end] = (
            reached.min() + charge,
            open_starts[int(reached.argmin())],
        )
        keep = (length < LEAST_INTERVAL_WINDOWS) | (reached <= cost[end])
        open_starts = np.append(open_starts[keep], end - LEAST_INTERVAL_WINDOWS + 1)
    edges = [n]
    while edges[-1] > 0:
        edges.append(int(last[edges[-1]]))
    return tuple(edges[::-1])


def intervals(found: list[Levels], joint: int) -> list[Region]:
    """The stretches in which a joint's gap is far above that in the rest of all recordings; the largest first.

    The hottest stretch is tried, then the hottest two: a contact may come twice.
    """
    if not found:
        return []
    square = np.concatenate([level.rms for level in found]) ** 2
    starts = np.cumsum([0, *(len(level.rms) for level in found)])
    stretches = [
        (level, a, b, slice(begin + a, begin + b))
        for level, begin in zip(found, starts, strict=False)
        for a, b in zip(level.edges, level.edges[1:], strict=False)
        if len(level.edges) - 2 <= MOST_CHANGE_POINTS
    ]
    hottest = sorted(stretches, key=lambda stretch: -square[stretch[3]].mean())
    for count in range(1, min(MOST_INTERVALS, len(hottest)) + 1):
        chosen = hottest[:count]
        outside = np.ones(len(square), dtype=bool)
        for *_, place in chosen:
            outside[place] = False
        share, coverage = (
            float(square[~outside].sum() / max(square.sum(), 1e-300)),
            float((~outside).mean()),
        )
        if share < max(REGION_SHARE, REGION_ENRICHMENT * coverage) or not outside.any():
            continue
        if all(_stands_out(square[place], square[outside]) for *_, place in chosen):
            parts = [
                (
                    float(square[p].sum() / square.sum()),
                    (p.stop - p.start) / len(square),
                )
                for *_, p in chosen
            ]
            regions = [
                _region(level, a, b, joint, *part)
                for (level, a, b, _), part in zip(chosen, parts, strict=True)
            ]
            return sorted(regions, key=lambda region: -region.share)
    return []


def _stands_out(inside: np.ndarray, outside: np.ndarray) -> bool:
    """Whether the squared level in an interval is far above that of any stretch outside of the same length."""
    length = min(len(inside), len(outside))
    elsewhere = np.convolve(outside, np.full(length, 1.0 / length), mode="valid").max()
    return bool(inside.mean() > INTERVAL_RATIO * elsewhere)


def _region(
    level: Levels, a: int, b: int, joint: int, share: float, coverage: float
) -> Region:
    start = float(level.t[a] - LEVEL_WINDOW / 2) if a > 0 else None
    end = float(level.t[b - 1] + LEVEL_WINDOW / 2) if b < len(level.t) else None
    if start is None:
        words = (
            f"all of {level.recording}"
            if end is None
            else f"{level.recording}, until it stops at {end:.1f} s"
        )
    elif end is None:
        words = f"{level.recording}, from {start:.1f} s, where it starts, to the end"
    else:
        words = f"{level.recording}, starts at {start:.1f} s and stops at {end:.1f} s"
    detail = {"recording": level.recording, "start": start, "end": end}
    return Region(joint, "interval", words, share, coverage, detail)
