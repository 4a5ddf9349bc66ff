"""Change points: values by hand, rates of false alarms, and changes that are found where they are."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from scipy.stats import norm

from gapscope.diagnosis.fleet.change_points import (
    appearance,
    change_point,
    change_points,
    scatter,
)


def test_two_estimates_are_compared_as_by_hand() -> None:
    found = change_point(np.array([1.0, 2.0]), np.array([0.3, 0.4]))
    assert (found.position, found.before, found.after) == (1, 1.0, 2.0)
    assert found.z == pytest.approx(1.0 / 0.5)
    assert found.p == pytest.approx(2 * norm.sf(2.0))


def test_the_change_is_between_the_means_of_its_parts() -> None:
    values, stds = np.array([1.0, 1.2, 3.0, 3.1, 2.9]), np.full(5, 0.1)
    found = change_point(values, stds)
    assert found.position == 2 and found.p < 1e-9
    assert (found.before, found.after) == pytest.approx((1.1, 3.0))
    assert found.before_std == pytest.approx(0.1 / np.sqrt(2))


def test_units_and_zero_do_not_matter() -> None:
    rng = np.random.default_rng(4)
    values, stds = rng.standard_normal(8), rng.uniform(0.5, 2.0, 8)
    plain = change_point(values, stds)
    scaled = change_point(1e-9 * (values + 7.0), 1e-9 * stds)
    assert (scaled.position, scaled.p) == pytest.approx((plain.position, plain.p))


@pytest.mark.parametrize("n", [3, 12, 50])
def test_false_alarms_are_no_more_than_stated(n: int) -> None:
    rng, count = np.random.default_rng(n), 1500
    p = np.empty(count)
    for k in range(count):
        stds = np.exp(rng.normal(0.0, 0.5, n))
        p[k] = change_point(stds * rng.standard_normal(n), stds).p
    # three standard deviations of the count above 5 %, and no less than half of it: a bound that is of use
    assert 0.025 < (p <= 0.05).mean() < 0.05 + 3 * np.sqrt(0.05 * 0.95 / count)


def test_several_changes_are_found_in_order() -> None:
    rng = np.random.default_rng(1)
    values = np.repeat([1.0, 2.0, 1.5], 10) + 0.05 * rng.standard_normal(30)
    found = change_points(values, np.full(30, 0.05), level=0.001)
    assert [change.position for change in found] == [10, 20]
    assert change_points(values[:10], np.full(10, 0.05), level=0.001) == ()
    assert change_points(values[9:11], np.full(2, 0.05), level=0.001) == ()


def test_appearance_counts_all_orders() -> None:
    assert appearance([False] * 5 + [True] * 3) == (5, pytest.approx(2 / 56))
    n, m = 9, 4
    orders = [[k in chosen for k in range(n)] for chosen in combinations(range(n), m)]
    p = np.array([appearance(order)[1] for order in orders])
    # exact: as many orders as it says have a probability as small
    for level in np.unique(p):
        assert (p <= level + 1e-12).mean() == pytest.approx(level)


def test_an_effect_that_is_always_named_has_not_appeared() -> None:
    assert appearance([True] * 6)[1] == appearance([False] * 6)[1] == 1.0


def test_scatter_is_seen_beside_changes() -> None:
    rng = np.random.default_rng(2)
    histories = [(3.0 * rng.standard_normal(10), np.ones(10)) for _ in range(100)]
    for values, _ in histories[:10]:
        values[5:] += 50.0
    assert scatter(histories) == pytest.approx(3.0, rel=0.1)
    assert scatter([(0.1 * values, stds) for values, stds in histories]) == 1.0
    assert scatter(histories[:1]) == 1.0
