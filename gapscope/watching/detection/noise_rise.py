"""What no parameter explains and yet rises: a cumulative sum of each joint's noise power."""

from __future__ import annotations

import numpy as np

from gapscope.watching.thresholds import CUSUM_LIMIT, CUSUM_STEP, RISE


class NoiseRise:
    """Page's cumulative sum of ln power over what is held for normal, g = max(0, g + ln(power / ``RISE``)).

    No block adds more than ``CUSUM_STEP``, so that at least ``CUSUM_LIMIT / CUSUM_STEP`` of them are needed.

    Args:
        sums: g of each joint so far [1], shape (n,).
        blocks: since g left zero, (n,).
        powers: sum of ln power over them [1], (n,).

    Source: page1954.
    """

    def __init__(
        self, sums: np.ndarray, blocks: np.ndarray, powers: np.ndarray
    ) -> None:
        self.sums, self.blocks, self.powers = sums, blocks, powers

    @classmethod
    def of(cls, n_joints: int) -> NoiseRise:
        """At the start, of n joints."""
        return cls(np.zeros(n_joints), np.zeros(n_joints), np.zeros(n_joints))

    def add(self, power: np.ndarray) -> tuple[int, ...]:
        """The joints, from 1, whose sum exceeds the limit after a block of a noise power over the normal [1], (n,)."""
        level = np.log(np.maximum(power, 1e-6))
        step = np.minimum(level - np.log(RISE), CUSUM_STEP)
        self.sums = np.maximum(0.0, self.sums + step)
        running = self.sums > 0
        self.blocks = np.where(running, self.blocks + 1, 0)
        # geometric mean since the sum left zero
        self.powers = np.where(running, self.powers + level, 0.0)
        return tuple(int(j) + 1 for j in np.flatnonzero(self.sums > CUSUM_LIMIT))

    def growth(self) -> np.ndarray:
        """Noise since the sum of a joint left zero, over the normal one [1], shape (n,): a ratio of RMS."""
        return np.exp(0.5 * self.powers / np.maximum(self.blocks, 1))
