"""The tail of the chi-squared distribution, far beyond what a floating-point probability holds."""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincc, gammaln

LARGE = 300.0
"""Half a statistic from which on its tail is computed by the leading term [1]; exp(-700) is the least number."""


def log_chance(statistic: float, freedom: float) -> float:
    """Minus ln of the probability that chi-squared with some degrees of freedom exceeds a statistic x [1].

    Of a large x with s degrees by the leading term, x / 2 - (s / 2 - 1) log(x / 2) + log Gamma(s / 2): the probability
    itself is no number that a computer holds.
    """
    half, power = 0.5 * max(statistic, 0.0), 0.5 * freedom
    if half < LARGE:
        return -float(np.log(gammaincc(power, half)))
    return float(half - (power - 1) * np.log(half) + gammaln(power))
