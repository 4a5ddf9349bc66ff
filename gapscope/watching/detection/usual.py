"""How large a statistic usually is, beside what it would be without errors of the model."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

import numpy as np
from scipy.special import chdtri

from gapscope.watching.thresholds import USUAL_KEPT, USUAL_LEAST, USUAL_LEVELS


class UsualSize:
    """Recent values of a statistic that is chi-squared without errors of the model.

    Args:
        values: recent ones over their degrees of freedom, the oldest first.
    """

    def __init__(self, values: Iterable[float] = ()) -> None:
        self.values: deque[float] = deque(values, maxlen=USUAL_KEPT)
        self._quantiles: np.ndarray | None = None

    def add(self, statistic: float, freedom: float) -> None:
        """Another value, of a time without an alarm."""
        self.values.append(statistic / max(freedom, 1.0))
        self._quantiles = None

    def factor(self, freedom: float) -> float:
        """By how much its median and its 90 % quantile exceed those of chi-squared, at least 1 [1]."""
        if len(self.values) < USUAL_LEAST:
            return 1.0
        freedom = max(freedom, 1.0)
        levels = np.array(USUAL_LEVELS)
        if self._quantiles is None:
            self._quantiles = np.quantile(np.array(self.values), levels)
        expected = chdtri(freedom, 1 - levels) / freedom
        return float(max(1.0, (self._quantiles / expected).max()))
