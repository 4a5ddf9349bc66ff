"""Interquartile means and their intervals."""

import numpy as np
import pytest

from gapscope.agents.summary import interquartile_mean, mean_of, rank_correlation


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


def test_strata_keep_their_weight() -> None:
    """Within a stratum all values are alike, so that nothing varies."""
    mean = mean_of(
        [1.0, 1.0, 9.0, 9.0], ["slow", "slow", "fast", "fast"], np.random.default_rng(0)
    )
    assert mean == (5.0, 5.0, 5.0)


def test_rank_correlation() -> None:
    assert rank_correlation([1, 2, 3], [10, 100, 1000]) == pytest.approx(1.0)
    assert rank_correlation([1, 2, 3], [3, 2, 1]) == pytest.approx(-1.0)
    assert (
        rank_correlation([1, 2], [3, 2]) is None
        and rank_correlation([1, 1, 1], [3, 2, 1]) is None
    )
