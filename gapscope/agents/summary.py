"""An evaluation in figures: means that outliers do not carry away, and how torque and tracking error go together."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from math import isfinite, nan
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import binomtest, spearmanr, trim_mean

from gapscope.agents.evaluation import Evaluation
from gapscope.arm.io.json_file import plain

LEVEL = 0.95
"""Coverage of the intervals [1]."""
DRAWS = 2000
"""Bootstrap draws."""


class Mean(NamedTuple):
    """An interquartile mean with its interval, in the unit of the values; infinite if too many runs diverged."""

    value: float
    low: float
    high: float


def mean_of(
    values: Sequence[float],
    strata: Sequence[Hashable],
    rng: np.random.Generator,
) -> Mean:
    """Interquartile mean with the percentile interval of a stratified bootstrap.

    A quarter of the values, rounded down, is left out at both ends; infinite ones count as the largest (agarwal2021).
    Runs are drawn with replacement within each stratum, so that every motion keeps its weight (agarwal2021). With
    one run per stratum the interval is the value.

    Args:
        values: of the runs.
        strata: what they are drawn within, one per value, such as the motion.
        rng: source of the draws.
    """
    if not len(values):
        return Mean(nan, nan, nan)
    array = np.asarray(values, dtype=float)
    places_of: dict[Hashable, list[int]] = {}
    for place, stratum in enumerate(strata):
        places_of.setdefault(stratum, []).append(place)
    # one column for each draw: places of all strata together, (N, draws)
    drawn = []
    for places in places_of.values():
        count = len(places)
        drawn.append(np.array(places)[rng.integers(count, size=(count, DRAWS))])
    resampled = trim_mean(array[np.concatenate(drawn)], 0.25)
    tails = [(1 - LEVEL) / 2, (1 + LEVEL) / 2]
    # a value that was drawn: infinite ones cannot be interpolated
    low, high = np.quantile(resampled, tails, method="nearest")
    return Mean(float(trim_mean(array, 0.25)), float(low), float(high))


SEED = 20
"""Of the bootstrap: the same episodes give the same intervals."""
MEASURES = ("joint_error", "tool_error", "reward", "torque_rate", "torque_error")
"""Measures of an episode that are summarised."""


class SummaryLine(NamedTuple):
    """Summary of one model in one engine under one disturbance: interquartile means over seeds and motions.

    Attributes:
        model, engine, disturbance: which.
        episodes, diverged: how many, and how many of them diverged.
        means: by measure, see ``gapscope.agents.evaluation.Episode``.
        margin: largest stable bandwidth [Hz], or ``None`` if it was not sought.
    """

    model: str
    engine: str
    disturbance: str
    episodes: int
    diverged: int
    means: dict[str, Mean]
    margin: float | None

    def plain(self) -> dict[str, Any]:
        """As JSON data."""
        # Wilson's interval says something even if none of a few runs diverged
        low, high = binomtest(self.diverged, self.episodes).proportion_ci(
            method="wilson"
        )
        means = {name: mean._asdict() for name, mean in self.means.items()}
        return {
            "model": self.model,
            "engine": self.engine,
            "disturbance": self.disturbance,
            "episodes": self.episodes,
            "diverged": {"count": self.diverged, "low": low, "high": high},
            **plain(means, null_if_not_finite=True),
            "margin": self.margin,
        }


def summarise(evaluation: Evaluation) -> list[SummaryLine]:
    """A line per disturbance, engine and model, the models in the order in which they were tried."""
    rows = pd.DataFrame(evaluation.episodes)
    lines = []
    for kind in rows["disturbance"].unique():
        own = rows[rows["disturbance"] == kind]
        for (model, engine), group in own.groupby(["model", "engine"], sort=False):
            motions = group["motion"].tolist()
            means = {}
            for name in MEASURES:
                # the same draws for each measure: they differ by values alone
                rng = np.random.default_rng(SEED)
                means[name] = mean_of(group[name].tolist(), motions, rng)
            count, margin = len(group), evaluation.margins.get((model, engine))
            diverged = int(group["diverged"].sum())
            lines.append(
                SummaryLine(model, engine, kind, count, diverged, means, margin)
            )
    return lines


def relation(lines: Sequence[SummaryLine]) -> float | None:
    """Spearman's correlation over models and engines of torque error and joint error [1].

    Of the first disturbance alone; ``None`` for fewer than three values, or equal ones.
    """
    first = [line for line in lines if line.disturbance == lines[0].disturbance]
    # a model that diverged has no error to be ranked by
    known = [line for line in first if isfinite(line.means["joint_error"].value)]
    torque, joint = (
        [line.means[name].value for line in known]
        for name in ("torque_error", "joint_error")
    )
    # a rank needs values that differ
    if len(known) < 3 or len(set(torque)) == 1 or len(set(joint)) == 1:
        return None
    return float(spearmanr(torque, joint).statistic)
