"""Decimated rows of a low-passed series are those of the low-pass itself."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.model.conditioning import low_pass
from gapscope.model.decimating_filter import low_passed_rows


@pytest.mark.parametrize("columns", [1, 9])
@pytest.mark.parametrize(
    ("rate", "cutoff", "count", "kept"),
    [
        (125.0, 12.0, 2501, slice(38, 2463, 4)),
        (100.0, 12.0, 6000, slice(30, 5970, 3)),
        (1000.0, 12.0, 20_000, slice(300, 19_700, 33)),
        (125.0, 5.0, 2500, slice(0, 2500, 10)),
        (250.0, 40.0, 4000, slice(75, 3925, 2)),
        (125.0, 12.0, 120, slice(38, 82, 4)),
        (29.0, 11.6, 700, slice(9, 691, 1)),
        (30.0, 12.0, 700, slice(9, 691, 2)),
    ],
)
def test_the_rows_are_those_of_the_low_pass(
    rate: float, cutoff: float, count: int, kept: slice, columns: int
) -> None:
    """Of a random walk with an offset, whose ends differ."""
    rng = np.random.default_rng(0)
    walk = 5.0 + np.cumsum(rng.normal(size=(count, columns)), axis=0)
    series = walk + rng.normal(size=walk.shape)
    expected = low_pass(series, rate, cutoff)[kept]
    found = low_passed_rows(series, rate, cutoff, kept)
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())


def test_what_is_zero_stays_zero() -> None:
    series = np.zeros((3000, 3))
    series[:, 1] = 1.0
    rows = low_passed_rows(series, 125.0, 12.0, slice(38, 2962, 4))
    assert not rows[:, [0, 2]].any()
    np.testing.assert_allclose(rows[:, 1], 1.0, atol=1e-9)
