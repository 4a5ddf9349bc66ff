"""Each way to count independent samples, against values worked out by hand or against drawn series."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.model.conditioning import low_pass
from gapscope.model.effective_samples import (
    autocovariance,
    band_samples,
    group_slices,
    independent_samples,
    low_pass_inflation,
    motion_samples,
    variance_inflation,
)

INTERVAL = 0.02


@pytest.mark.parametrize(("rho", "share"), [(0.0, 1.0), (0.5, 1 / 3), (0.9, 1 / 19)])
def test_effective_samples_of_an_autoregressive_series(
    rho: float, share: float
) -> None:
    rng = np.random.default_rng(0)
    x = np.zeros((20000, 1))
    for i in range(1, len(x)):
        x[i] = rho * x[i - 1] + rng.standard_normal()
    assert independent_samples(x)[0] == pytest.approx(share * len(x), rel=0.15)


def test_a_series_that_hardly_changes_counts_as_four_samples() -> None:
    assert independent_samples(np.linspace(0, 1, 100)[:, None])[0] == 4.0


def test_samples_of_a_band_and_of_a_motion() -> None:
    assert band_samples(10.0, 12.0) == 240.0
    assert motion_samples(10.0, 3.0) == 30.0


def test_group_slices_by_hand() -> None:
    assert group_slices(np.array([0, 0, 1, 3, 3])) == [
        slice(0, 2),
        slice(2, 3),
        slice(3, 5),
    ]


def test_autocovariance_by_hand_and_within_groups() -> None:
    """1, 2 | 3, 4: lag 0 is 30 / 4; lag 1 only within groups, (1 * 2 + 3 * 4) / 4."""
    found = autocovariance(
        np.array([[1.0], [2.0], [3.0], [4.0]]), np.array([0, 0, 1, 1]), 1
    )
    assert np.allclose(found[:, 0], [7.5, 3.5])


def test_inflation_of_a_first_order_process() -> None:
    """AR(1) with 0.8: (1 + 0.8) / (1 - 0.8) = 9."""
    rng = np.random.default_rng(0)
    series = rng.standard_normal((20000, 3))
    for i in range(1, len(series)):
        series[i] += 0.8 * series[i - 1]
    assert np.allclose(
        variance_inflation(series, np.zeros(len(series), int)), 9.0, rtol=0.25
    )


def test_inflation_of_a_low_pass() -> None:
    """Of a long series of filtered noise; at Nyquist's frequency nothing was filtered."""
    series = low_pass(
        np.random.default_rng(0).standard_normal((50000, 4)), 1 / INTERVAL, 5.0
    )
    blocks = series.reshape(100, 500, 4).mean(axis=1)
    assert low_pass_inflation(5.0, INTERVAL) == pytest.approx(
        500 * blocks.var() / series.var(), rel=0.15
    )
    assert low_pass_inflation(25.0, INTERVAL) == 1.0
