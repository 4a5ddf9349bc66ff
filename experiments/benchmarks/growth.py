"""Exponents of growth: how a cost grows with a size, by a line through its logarithms."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from experiments.benchmarks.row import MEMORY, Row

STOPPED = "stopped after [s]"
"""Detail of a row whose measurement was stopped, so that its figure is a lower bound [s]."""
FEWEST = 3
"""Points from which an exponent follows."""


def along(
    rows: Iterable[Row], size: str, others: Mapping[str, float | str]
) -> list[Row]:
    """The rows on a curve over one of their sizes, sorted: all other sizes have these values, and this is not zero."""
    chosen = [
        row
        for row in rows
        if row.sizes.get(size)
        and STOPPED not in row.details
        and all(row.sizes.get(key) == value for key, value in others.items())
    ]
    return sorted(chosen, key=lambda row: float(row.sizes[size]))


def exponents(curve: Sequence[Row], size: str) -> list[Row]:
    """Exponent of time and of peak memory on a curve, cost ~ size^exponent; none if it has too few points."""
    if len(curve) < FEWEST:
        return []
    sizes = np.array([float(row.sizes[size]) for row in curve])
    time = np.array([row.figure for row in curve])
    memory = np.array([float(row.details[MEMORY]) for row in curve])
    return [
        _row(f"time over {size}", sizes, time),
        _row(f"peak memory over {size}", sizes, memory),
    ]


def _row(name: str, sizes: np.ndarray, cost: np.ndarray) -> Row:
    """Exponent of all points, and that between the two largest, where what is fixed counts least."""
    x, y = np.log(sizes), np.log(cost)
    slope, offset = np.polyfit(x, y, 1)
    residual = y - offset - slope * x
    error = np.sqrt((residual**2).sum() / (len(x) - 2) / ((x - x.mean()) ** 2).sum())
    return Row(
        name,
        float(slope),
        "exponent",
        spread=float(error),
        note=f"{sizes[0]:g} to {sizes[-1]:g}; ± is the standard error",
        details={"between the last two": float((y[-1] - y[-2]) / (x[-1] - x[-2]))},
    )
