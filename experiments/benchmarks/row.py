"""A line of the benchmark table, and how it comes from times measured in turns."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

Clock = Callable[[], float]
MEMORY = "peak memory [MB]"
"""Key of a row's details."""


@dataclass(frozen=True)
class Row:
    """One figure, and what it is relative to a yardstick that was measured in the same run.

    Attributes:
        name: what was measured.
        figure: the median over the rounds, or the only value.
        unit: of the figure; ``s`` are seconds of the processor unless the note says otherwise.
        spread: half the distance between the quartiles over the rounds, in the same unit; ``None``: measured once.
        ratio: speed relative to the yardstick, so that 2 is twice as fast; the median of the rounds' ratios.
        ratio_spread: half the distance between the quartiles of the ratio.
        yardstick: name of what the ratio is to.
        note: what else is to know in a few words.
        details: other figures by name, with their unit.
        sizes: where it lies on a curve of growth; not part of the table.
    """

    name: str
    figure: float
    unit: str
    spread: float | None = None
    ratio: float | None = None
    ratio_spread: float | None = None
    yardstick: str = ""
    note: str = ""
    details: Mapping[str, float | str] = field(default_factory=dict)
    sizes: Mapping[str, float | str] = field(default_factory=dict)


def half_quartiles(values: Sequence[float]) -> float | None:
    """Half the distance between the quartiles; ``None`` of a single value."""
    if len(values) < 2:
        return None
    low, high = np.quantile(values, (0.25, 0.75))
    return float(high - low) / 2


def in_turns(
    loops: Mapping[str, Callable[[], object]],
    rounds: int,
    clock: Clock = time.process_time,
) -> dict[str, list[float]]:
    """Time of each loop in each round [s]; the loops take turns, so that a busy machine slows all of a round."""
    times: dict[str, list[float]] = {name: [] for name in loops}
    for _ in range(rounds):
        for name, loop in loops.items():
            start = clock()
            loop()
            times[name].append(clock() - start)
    return times


def compared(
    times: Mapping[str, Sequence[float]],
    yardstick: str,
    unit: str = "s",
    per: float = 1.0,
    what: str = "",
    notes: Mapping[str, str] | None = None,
) -> list[Row]:
    """A row for each loop, relative to one of them.

    Args:
        times: time of each loop in each round [s].
        yardstick: the loop that the ratios are to; it has ratio 1 itself.
        unit: of the figures, which are the times over ``per``.
        per: what a time is divided by, for instance the number of steps.
        what: what all of them do; the rows' names begin with it.
        notes: a note for some of them.
    """
    rows = []
    base = np.array(times[yardstick])
    for name, values in times.items():
        ratios = base / np.array(values)
        row = Row(
            f"{what}, {name}" if what else name,
            float(np.median(values)) / per,
            unit,
            spread=_scaled(half_quartiles(values), per),
            ratio=float(np.median(ratios)),
            ratio_spread=half_quartiles(ratios.tolist()),
            yardstick=yardstick,
            note=(notes or {}).get(name, ""),
        )
        rows.append(row)
    return rows


def _scaled(value: float | None, per: float) -> float | None:
    return None if value is None else value / per
