"""The time of a log: which column, in which unit, or at which rate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gapscope.arm.io.plausibility import unit_of_stamps
from gapscope.inspection.words import derivative_ratio, meaning_of

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
USUAL_RATES = (
    30,
    50,
    60,
    100,
    125,
    200,
    240,
    250,
    400,
    500,
    800,
    1000,
    2000,
    4000,
    5000,
    8000,
)
"""Rates at which arms are logged [Hz]; a measured rate within 3 % of one is taken as that."""
FALLBACK_RATE = 100.0
"""Rate that a case is drafted with if nothing in the log tells it [Hz]."""


@dataclass(frozen=True)
class TimeGuess:
    """Where the time stands.

    Attributes:
        column: name, or ``None`` if there is none.
        unit: of the column; empty if it counts samples or there is none.
        rate: median rate [Hz], of the stamps or, if they tell none, as guessed.
        seconds: (N,), from 0.
        why: what the guess rests on.
        start: time of the first row on the clock of the log [s].
        certain: whether the log itself tells the rate.
    """

    column: str | None
    unit: str
    rate: float
    seconds: np.ndarray
    why: str
    start: float = 0.0
    certain: bool = True


def guess_time(
    singles: Mapping[str, np.ndarray],
    rows: np.ndarray,
    position: np.ndarray | None,
    velocity: np.ndarray | None,
) -> TimeGuess:
    """Time of a table with N rows.

    Args:
        singles: columns of numbers that belong to no joint, (N,) each.
        rows: their numbers in the file, (N,).
        position, velocity: what is taken for q and dq, (N, n), in any unit; their ratio tells the rate if the
            column counts samples or there is none.
    """
    named = [name for name in singles if meaning_of(name).quantity == "time"]
    rising = [name for name in singles if runs_forward(singles[name])]
    for name in [*(n for n in named if n in rising), *named, *rising]:
        stamps = singles[name]
        if not np.isfinite(stamps).all():
            continue
        if counts_rows(stamps):
            return _counted(name, rows, position, velocity)
        guess = _stamped(name, stamps)
        if guess is not None:
            return guess
    return _counted(None, rows, position, velocity)


def runs_forward(stamps: np.ndarray) -> bool:
    """Whether numbers never fall and mostly rise."""
    step = np.diff(stamps)
    return bool(len(step) and (step >= 0).all() and (step > 0).mean() > 0.8)


def counts_rows(stamps: np.ndarray) -> bool:
    """Whether a column counts rows: whole numbers that rise by one."""
    step = np.diff(stamps)
    return (
        bool(len(step))
        and float(np.median(step)) == 1.0
        and bool((step == np.round(step)).all())
    )


def _stamped(name: str, stamps: np.ndarray) -> TimeGuess | None:
    """The unit in which stamps make a rate that robots are logged at; seconds first, but for what the name says."""
    step = np.diff(stamps)
    if not (step > 0).any():
        return None
    median = float(np.median(step[step > 0]))
    likely = unit_of_stamps(1.0 / median, float(stamps[-1] - stamps[0]))
    said = [unit for unit in TIME_UNITS if name.lower().endswith(f"_{unit}")]
    if said and unit_of_stamps(1.0 / (median * TIME_UNITS[said[0]]), np.inf) == "s":
        likely = said[0]
    # of what is called a time, but too slow in any unit, the reader says so
    unit = likely or ("s" if meaning_of(name).quantity == "time" else "")
    if not unit:
        return None
    factor = TIME_UNITS[unit]
    rate = 1.0 / (median * factor)
    seconds = (stamps - stamps[0]) * factor
    why = f"its steps in {unit} make {rate:.4g} Hz"
    return TimeGuess(name, unit, rate, seconds, why, float(stamps[0]) * factor)


def _counted(
    column: str | None,
    rows: np.ndarray,
    position: np.ndarray | None,
    velocity: np.ndarray | None,
) -> TimeGuess:
    """Time from the number of the row, with the rate at which the velocity is the derivative of the position."""
    what = "the column counts rows" if column else "there is no column of time"
    rate, certain = FALLBACK_RATE, False
    why = f"{what}, and nothing in the log tells the rate: look it up"
    if position is not None and velocity is not None:
        # per row in place of per second, the ratio is the rate
        found = derivative_ratio(rows, position, velocity)
        if found is not None and found > 0:
            rate, certain = _usual(found), True
            why = f"{what}; the velocity is the derivative of the position at {found:.4g} Hz"
    seconds = (rows - rows[:1]) / rate
    return TimeGuess(column, "", rate, seconds, why, certain=certain)


def _usual(rate: float) -> float:
    nearest = min(USUAL_RATES, key=lambda usual: abs(np.log(usual / rate)))
    return float(nearest) if abs(nearest / rate - 1) < 0.03 else float(f"{rate:.4g}")
