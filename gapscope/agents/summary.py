"""An evaluation in figures: per model, engine and disturbance, and how torque and tracking error go together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite
from operator import attrgetter
from typing import Any

import numpy as np
from scipy.stats import binomtest

from gapscope.agents.episode import Episode
from gapscope.agents.evaluation import Evaluation
from gapscope.agents.statistics import Mean, mean_of, rank_correlation
from gapscope.arm.io.json_file import plain

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
        means: by measure, see ``gapscope.agents.tracking_metrics.Measures``.
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
