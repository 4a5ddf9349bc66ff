"""Whether values estimated on several units are the same but for their uncertainty, and what their common value is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from gapscope.diagnosis.thresholds import EFFECT_FORM

ROUNDING = 1e-9
"""Relative standard deviation below which a value is treated as exact up to rounding [1]."""


@dataclass(frozen=True)
class Pooled:
    """Values x_i with standard deviations s_i of k units, taken together.

    Fixed effect: weights w_i = 1 / s_i^2, mean m = sum w x / sum w. Cochran's Q = sum w_i (x_i - m)^2 is chi-squared
    with k - 1 degrees of freedom if all units have one value [cochran1954]; I^2 = max(0, 1 - (k - 1) / Q) is the
    share of the scatter that the s_i do not account for [higgins2002]. Random effects: each unit has its own value,
    drawn around the common one with variance tau^2, here by moments [dersimonian1986].

    Attributes:
        estimate: common value, weights 1 / (s_i^2 + tau^2).
        std: its standard deviation.
        between: tau, by which the units differ beyond their s_i.
        q: Cochran's Q [1].
        p: probability of a Q at least as large if all units have one value [1].
        i_squared: I^2 [1].
    """

    estimate: float
    std: float
    between: float
    q: float
    p: float
    i_squared: float


def pooled(
    values: Sequence[float], stds: Sequence[float | None], form: float = EFFECT_FORM
) -> Pooled:
    """Take the values of several units together.

    Args:
        values: one per unit, (k,).
        stds: their standard deviations, in the same unit; ``None`` or 0 if not known.
        form: share of the mean magnitude that is added to each deviation in squares: the catalogue's laws are simple,
            real ones differ in form, and two units that were moved differently then differ by that much.
    """
    x = np.asarray(values, dtype=float)
    size = np.abs(x).mean()
    s = np.array([0.0 if std is None else std for std in stds])
    s = np.sqrt(
        s**2 + (form * size) ** 2 + (ROUNDING * size) ** 2 + np.finfo(float).tiny
    )
    unit = (
        s.min()
    )  # weights relative to the largest: no overflow if deviations are tiny
    w = (unit / s) ** 2
    mean = x[0] + (w * (x - x[0])).sum() / w.sum()
    q = float((w * ((x - mean) / unit) ** 2).sum())
    freedom = len(x) - 1
    spread = w.sum() - (w**2).sum() / w.sum()
    tau2 = max(0.0, q - freedom) / spread * unit**2 if freedom and spread > 0 else 0.0
    w = unit**2 / (s**2 + tau2)
    return Pooled(
        estimate=float(x[0] + (w * (x - x[0])).sum() / w.sum()),
        std=float(unit / np.sqrt(w.sum())),
        between=float(np.sqrt(tau2)),
        q=q,
        p=float(chi2.sf(q, freedom)) if freedom else 1.0,
        i_squared=max(0.0, 1.0 - freedom / q) if q > 0 else 0.0,
    )
