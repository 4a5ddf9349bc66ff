"""Shares with intervals, and how good probabilities are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import binomtest


class Proportion(NamedTuple):
    """A count over a number of cases."""

    hits: int
    total: int

    @property
    def rate(self) -> float | None:
        """Hits over total, or ``None`` without cases."""
        return self.hits / self.total if self.total else None

    def plain(self) -> dict[str, Any]:
        """As JSON data, with Wilson's interval."""
        low, high = wilson(self.hits, self.total)
        return {
            "hits": self.hits,
            "count": self.total,
            "rate": self.rate,
            "low": low,
            "high": high,
        }


def proportion(values: Sequence[bool]) -> Proportion:
    """Share of what is true."""
    return Proportion(int(sum(values)), len(values))


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share [wilson1927]; (0, 1) without cases."""
    if not count:
        return 0.0, 1.0
    interval = binomtest(hits, count).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def brier(probability: np.ndarray, right: np.ndarray) -> float | None:
    """Mean of (p - right)^2, or ``None`` without findings."""
    return float(np.mean((probability - right) ** 2)) if len(probability) else None


def reliability(
    probability: np.ndarray, right: np.ndarray, bins: int = 10
) -> list[dict[str, float]]:
    """Per bin of probability that holds findings: its edges, how many, mean probability, share that is right."""
    bin_of = np.minimum((np.asarray(probability) * bins).astype(int), bins - 1)
    rows = []
    for k in range(bins):
        inside = bin_of == k
        if inside.any():
            rows.append(
                {
                    "from": k / bins,
                    "to": (k + 1) / bins,
                    "count": int(inside.sum()),
                    "probability": float(probability[inside].mean()),
                    "right": float(right[inside].mean()),
                }
            )
    return rows


def ece(probability: np.ndarray, right: np.ndarray, bins: int = 10) -> float | None:
    """Expected calibration error: mean over findings of |mean p - share right| of the bin; ``None`` without any."""
    if not len(probability):
        return None
    weighted = 0.0
    for row in reliability(probability, right, bins):
        weighted += row["count"] * abs(row["probability"] - row["right"])
    return float(weighted / len(probability))


def smallest_set(candidates: Sequence[tuple[str, float]], level: float) -> list[str]:
    """The likeliest candidates until their probability reaches a level."""
    out, total = [], 0.0
    for name, probability in sorted(candidates, key=lambda c: -c[1]):
        out.append(name)
        total += probability
        if total >= level:
            break
    return out
