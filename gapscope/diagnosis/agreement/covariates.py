"""What a difference between recordings goes with: speed, temperature, load, time, or one recording alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.arm.recording import Recording
from gapscope.diagnosis.thresholds import (
    COVARIATE_CHANGE,
    COVARIATE_SHARE,
    COVARIATE_TEMPERATURE,
)
from gapscope.model.rows import Rows

SPEED, TEMPERATURE, LOAD, START, ORDER = (
    "speed",
    "temperature",
    "load",
    "start time",
    "order",
)
CLOCK = 1e8
"""Time stamps beyond this are those of a clock, not of the recording's start [s]."""
AS_WELL = 4.0
"""What leaves no more than this many times the least remainder explains about as well [1]."""


@dataclass(frozen=True)
class Covariate:
    """A property of the recordings.

    Attributes:
        name: speed, temperature, load, start time or order.
        unit: of the values.
        value: in each recording, (R,).
    """

    name: str
    unit: str
    value: np.ndarray

    def differs(self, among: np.ndarray) -> bool:
        """Whether some recordings, numbers (k,), differ in it enough to compare them by it."""
        value = self.value[among]
        apart = float(np.ptp(value))
        if self.name == TEMPERATURE:
            return apart >= COVARIATE_TEMPERATURE
        if self.name in (START, ORDER):
            return apart > 0.0
        return apart >= COVARIATE_CHANGE * float(np.abs(value).mean()) > 0.0


@dataclass(frozen=True)
class Explanation:
    """What a difference goes with.

    Attributes:
        goes_with: names of covariates that explain it about as well as the best; one name is an answer, several are
            not told apart by these recordings, none explains it.
        alone: number of the recording without which the others agree as well, or ``None``.
        shares: share of the squared deviations that each differing covariate explains [1], by name.
        changed: names of the covariates that differ, the most different first.
    """

    goes_with: tuple[str, ...]
    alone: int | None
    shares: dict[str, float]
    changed: tuple[str, ...]


def covariates(
    recordings: Sequence[Recording], rows: Rows, joint: int | None
) -> tuple[Covariate, ...]:
    """Covariates of a joint, from 1, or of the whole arm: mean |dq|, temperature, |torque|, start.

    Args:
        recordings: R recordings.
        rows: of them, a group each.
        joint: the joint; ``None`` for all.
    """
    places = slice(None) if joint is None else slice(joint - 1, joint)
    numbers = range(len(recordings))

    def mean(series: np.ndarray) -> np.ndarray:
        """Mean size in each recording, (R,)."""
        return np.array([np.abs(series[rows.of(k)][:, places]).mean() for k in numbers])

    found = [
        Covariate(SPEED, "rad/s", mean(rows.velocity)),
        Covariate(LOAD, "N m", mean(rows.torque)),
    ]
    logged = [r.temperature for r in recordings if r.temperature is not None]
    if len(logged) == len(recordings):
        warmth = np.array([series[:, places].mean() for series in logged])
        found.append(Covariate(TEMPERATURE, "deg C", warmth))
    starts = np.array([r.stamps[0] for r in recordings])
    if starts.min() > CLOCK:
        found.append(Covariate(START, "h", (starts - starts.min()) / 3600.0))
    else:
        found.append(Covariate(ORDER, "1", np.arange(1.0, len(recordings) + 1.0)))
    return tuple(found)


def explain(
    value: np.ndarray,
    std: np.ndarray,
    among: np.ndarray,
    candidates: Sequence[Covariate],
) -> Explanation:
    """What values that differ, (R,) with deviations, go with among the recordings that determine them, numbers (k,).

    A weighted line over each covariate leaves Q_res of Cochran's Q; so does leaving one recording out. Two recordings
    lie on a line over anything: nothing is named then.
    """
    differing = [one for one in candidates if one.differs(among)]
    differing.sort(key=lambda one: _relative_change(one, among), reverse=True)
    x, weight = value[among], std[among] ** -2.0
    total = _remainder(x, weight, np.ones((len(x), 1)))
    left = {}
    for one in differing:
        line = np.column_stack([np.ones(len(x)), one.value[among]])
        left[one.name] = _remainder(x, weight, line)
    shares = {name: 1.0 - rest / total for name, rest in left.items()}
    changed = tuple(left)
    if len(among) < 3:
        return Explanation((), None, shares, changed)
    apart = {}
    for place, number in enumerate(among.tolist()):
        step = np.column_stack([np.ones(len(x)), np.arange(len(x)) == place])
        apart[number] = _remainder(x, weight, step)
    odd = min(apart, key=lambda number: apart[number])
    least = min(min(left.values(), default=np.inf), apart[odd])
    if 1.0 - least / total < COVARIATE_SHARE:
        return Explanation((), None, shares, changed)
    # a remainder as small as noise leaves is as good as none
    border = AS_WELL * max(least, len(x) - 2.0)
    names = tuple(name for name in changed if left[name] <= border)
    return Explanation(names, odd if apart[odd] <= border else None, shares, changed)


def _relative_change(one: Covariate, among: np.ndarray) -> float:
    """Range over mean [1]; of times and temperatures, whose zero is arbitrary, below those of the others."""
    value = one.value[among]
    change = float(np.ptp(value) / max(np.abs(value).mean(), 1e-300))
    return change if one.name in (SPEED, LOAD) else min(change, COVARIATE_CHANGE)


def _remainder(x: np.ndarray, weight: np.ndarray, design: np.ndarray) -> float:
    """Sum of weighted squares that a design of few columns leaves."""
    root = np.sqrt(weight)
    # centred columns keep a covariate with a large mean well conditioned
    shifted = design - np.append(0.0, design[:, 1:].mean(axis=0))
    fit = np.linalg.lstsq(shifted * root[:, None], x * root, rcond=None)[0]
    return float((((x - shifted @ fit) * root) ** 2).sum())
