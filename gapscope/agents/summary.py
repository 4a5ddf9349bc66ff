"""An evaluation in figures: means that outliers do not carry away, and how torque and tracking error go together."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from math import isfinite, nan
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import binomtest, spearmanr, trim_mean

from gapscope.agents.evaluation import Episode, Evaluation
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


def interquartile_mean(values: np.ndarray) -> np.ndarray:
    """Mean of the middle half of the values along the first axis, shape (N, ...).

    A quarter of the N values, rounded down, is left out at both ends; below four values it is the plain mean. Infinite
    values count as the largest.

    Source: agarwal2021.
    """
    return np.asarray(trim_mean(np.asarray(values, dtype=float), 0.25, axis=0))


def mean_of(
    values: Sequence[float],
    strata: Sequence[Hashable],
    rng: np.random.Generator,
    draws: int = DRAWS,
) -> Mean:
    """Interquartile mean with the percentile interval of a stratified bootstrap.

    Runs are drawn with replacement within each stratum, so that every motion keeps its weight (agarwal2021). With
    one run per stratum the interval is the value.

    Args:
        values: of the runs.
        strata: what they are drawn within, one per value, such as the motion.
        rng: source of the draws.
        draws: how many.
    """
    if not len(values):
        return Mean(nan, nan, nan)
    array = np.asarray(values, dtype=float)
    places_of: dict[Hashable, list[int]] = {}
    for place, stratum in enumerate(strata):
        places_of.setdefault(stratum, []).append(place)
    drawn = []
    for places in places_of.values():
        count = len(places)
        drawn.append(np.array(places)[rng.integers(count, size=(count, draws))])
    resampled = interquartile_mean(array[np.concatenate(drawn)])
    tails = [(1 - LEVEL) / 2, (1 + LEVEL) / 2]
    # a value that was drawn: infinite ones cannot be interpolated
    low, high = np.quantile(resampled, tails, method="nearest")
    return Mean(float(interquartile_mean(array)), float(low), float(high))


def rank_correlation(x: Sequence[float], y: Sequence[float]) -> float | None:
    """Spearman's rank correlation [1], or ``None`` if there are fewer than three values or all are equal."""
    if len(x) < 3 or len(set(x)) == 1 or len(set(y)) == 1:
        return None
    return float(spearmanr(x, y).statistic)


SEED = 20
"""Of the bootstrap: the same episodes give the same intervals."""
MEASURES = ("joint_error", "tool_error", "reward", "torque_rate")
"""Measures of an episode that are summarised."""


@dataclass(frozen=True)
class SummaryLine:
    """Summary of one model in one engine under one disturbance: interquartile means over seeds and motions.

    Attributes:
        model, engine, disturbance: which.
        count, diverged: episodes, and how many of them diverged.
        means: by measure, see ``gapscope.agents.tracking.Measures``.
        torque_error: NRMSE of the feedforward [1].
        margin: largest stable bandwidth [Hz], or ``None`` if it was not sought.
    """

    model: str
    engine: str
    disturbance: str
    count: int
    diverged: int
    means: dict[str, Mean]
    torque_error: Mean
    margin: float | None

    def plain(self) -> dict[str, Any]:
        """As JSON data."""
        low, high = binomtest(self.diverged, self.count).proportion_ci(method="wilson")
        return {
            "model": self.model,
            "engine": self.engine,
            "disturbance": self.disturbance,
            "episodes": self.count,
            "diverged": {"count": self.diverged, "low": low, "high": high},
            **{name: _plain(mean) for name, mean in self.means.items()},
            "torque_error": _plain(self.torque_error),
            "margin": self.margin,
        }


def summarise(evaluation: Evaluation) -> list[SummaryLine]:
    """A line per disturbance, engine and model, the models in the order in which they were tried."""
    groups: dict[tuple[str, str, str], list[Episode]] = {}
    kinds = dict.fromkeys(episode.disturbance for episode in evaluation.episodes)
    for kind in kinds:
        for episode in evaluation.episodes:
            if episode.disturbance == kind:
                groups.setdefault((episode.model, episode.engine, kind), []).append(
                    episode
                )
    return [
        SummaryLine(
            *key,
            len(episodes),
            sum(e.measures.diverged for e in episodes),
            {
                name: _mean(episodes, attrgetter(f"measures.{name}"))
                for name in MEASURES
            },
            _mean(episodes, attrgetter("torque_error")),
            evaluation.margins.get(key[:2]),
        )
        for key, episodes in groups.items()
    ]


def relation(lines: Sequence[SummaryLine]) -> float | None:
    """Spearman's correlation over models and engines of torque error and joint error [1]; ``None`` for fewer than 3.

    Of the first disturbance alone.
    """
    first = [line for line in lines if line.disturbance == lines[0].disturbance]
    known = [line for line in first if isfinite(line.means["joint_error"].value)]
    return rank_correlation(
        [line.torque_error.value for line in known],
        [line.means["joint_error"].value for line in known],
    )


def _mean(episodes: Sequence[Episode], of: Callable[[Episode], float]) -> Mean:
    return mean_of(
        [of(e) for e in episodes],
        [e.motion for e in episodes],
        np.random.default_rng(SEED),
    )


def _plain(mean: Mean) -> dict[str, float | None]:
    return dict(plain(mean._asdict(), null_if_not_finite=True))
