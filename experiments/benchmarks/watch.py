"""A watch of seven joints: seconds of the processor per hour of a recording, by its rate, beside reading it alone.

The recording is one CSV file, followed from its start to its end as `gapscope watch --once` does, learning and state
included. 360 s an hour are a tenth of a core.
"""

from __future__ import annotations

from functools import partial

from threadpoolctl import threadpool_limits

from experiments.benchmarks.point import Point, Settings
from experiments.benchmarks.row import Row, compared, in_turns
from experiments.watch_speed import READ, loops

RATES = (100.0, 500.0, 1000.0)
"""Of the recordings [Hz]."""
SECONDS, SHORT = 300.0, 130.0
"""Length of the recordings [s]."""


def points(settings: Settings) -> list[Point]:
    """A point for each rate."""
    seconds = SHORT if settings.quick else SECONDS
    rates = RATES[:1] if settings.quick else RATES
    return [
        Point(f"{rate:g} Hz", partial(_measured, rate, seconds, settings.rounds))
        for rate in rates
    ]


def _measured(rate: float, seconds: float, rounds: int) -> list[Row]:
    with threadpool_limits(1), loops(rate, seconds) as each:
        times = in_turns(each, rounds)
    return compared(
        times, READ, "s an hour", seconds / 3600, f"7 joints at {rate:g} Hz"
    )
