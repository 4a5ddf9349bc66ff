"""Interquartile means and their intervals."""

import numpy as np

from gapscope.agents.summary import interquartile_mean, mean_of


def test_interquartile_mean_by_hand() -> None:
    assert interquartile_mean(np.array([1.0, 100.0, 3.0, 2.0])) == 2.5
    assert interquartile_mean(np.array([1.0, 2.0, 9.0])) == 4.0
    assert (
        interquartile_mean(np.array([8.0, 1.0, 2.0, 3.0, 4.0, np.inf, 5.0, 0.0])) == 3.5
    )
    assert interquartile_mean(np.array([1.0, np.inf, np.inf, 2.0])) == np.inf


def test_interval_covers_the_mean_of_a_normal_distribution() -> None:
    hits = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        mean = mean_of(
            rng.normal(5.0, 1.0, 24).tolist(), ["a", "b"] * 12, rng, draws=300
        )
        assert mean.low <= mean.value <= mean.high
        hits += mean.low <= 5.0 <= mean.high
    assert hits > 80
