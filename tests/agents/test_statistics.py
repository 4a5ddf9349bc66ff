"""Interquartile means and their intervals."""

import numpy as np

from gapscope.agents.evaluation import mean_of


def test_middle_half_of_runs_of_which_some_diverged() -> None:
    rng, runs = np.random.default_rng(0), [8.0, 1.0, 2.0, 3.0, 4.0, np.inf, 5.0, 0.0]
    assert mean_of(runs, range(8), rng) == dict.fromkeys(("value", "low", "high"), 3.5)


def test_interval_covers_the_mean_of_a_normal_distribution() -> None:
    hits = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        mean = mean_of(rng.normal(5.0, 1.0, 24).tolist(), ["a", "b"] * 12, rng)
        assert mean["low"] <= mean["value"] <= mean["high"]
        hits += mean["low"] <= 5.0 <= mean["high"]
    assert hits > 80
