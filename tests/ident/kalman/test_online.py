"""The filter in blocks against the filter by samples, and the comparison before and after a moment."""

import numpy as np
import pytest

from gapscope.ident.kalman.change_hypothesis import ChangeHypothesis
from gapscope.ident.kalman.online.before_after import BeforeAfter
from gapscope.ident.kalman.online.block import Equations
from gapscope.ident.kalman.online.estimate import ParameterState
from gapscope.ident.kalman.recursive import Recursive
from gapscope.ident.kalman.tail import log_chance
from gapscope.ident.model.linear_problem import Problem

NOISE = np.array([0.2, 0.5])
TRUE = np.array([1.0, -2.0, 0.5])


def equations(rng, count, value=TRUE):
    W = rng.standard_normal((count, 2, 3))
    gap = W @ value + NOISE * rng.standard_normal((count, 2))
    everywhere = np.ones((count, 2), dtype=bool)
    return Equations(W, gap, everywhere, gap, gap)


def compared(rng, after=TRUE, allowed=0.0):
    """30 samples before a moment and 20 after it, from a vague start."""
    start = ParameterState(np.zeros(3), 100.0 * np.eye(3))
    before = start.assimilated(*equations(rng, 30).normal(NOISE))
    A, s = equations(rng, 20, after).normal(NOISE)
    return BeforeAfter.of(before, np.full(3, allowed), A, s)


LAST = ChangeHypothesis("last", ("c",), np.eye(3)[:, 2:])
BOTH = ChangeHypothesis("both", ("b", "c"), np.eye(3)[:, 1:])


def test_blocks_give_the_estimate_of_a_filter_by_samples():
    rng = np.random.default_rng(0)
    start = ParameterState(np.array([0.5, 0.0, 0.0]), np.diag([1.0, 2.0, 3.0]))
    block = equations(rng, 40)
    group = np.zeros(40, dtype=int)
    problem = Problem(block.matrix, block.gap, ("a", "b", "c"), group, 0.01)
    by_samples = Recursive(NOISE, start.value, start.covariance).estimate(problem)
    in_blocks = start.assimilated(*block.normal(NOISE))
    assert in_blocks.value == pytest.approx(by_samples.value, rel=1e-9)
    assert in_blocks.covariance == pytest.approx(by_samples.covariance, rel=1e-6)


def test_without_a_change_the_statistic_is_chi_squared():
    rng = np.random.default_rng(1)
    found = [compared(rng).fit(BOTH).statistic for _ in range(400)]
    assert np.mean(found) == pytest.approx(2.0, abs=0.3)
    assert np.mean(np.array(found) > 5.99) == pytest.approx(0.05, abs=0.03)


def test_the_size_of_a_change_is_found_within_its_error():
    rng = np.random.default_rng(2)
    off = []
    for _ in range(200):
        fit = compared(rng, TRUE + np.array([0.0, 0.0, 0.4])).fit(LAST)
        off.append((fit.size[0] - 0.4) / np.sqrt(fit.covariance[0, 0]))
    assert np.mean(off) == pytest.approx(0.0, abs=0.25)
    assert np.std(off) == pytest.approx(1.0, abs=0.15)


def test_what_may_differ_without_a_change_bounds_the_statistic():
    """Of a difference of d, however many samples show it, no more than d^2 over the allowed variance remains."""
    rng = np.random.default_rng(3)
    change = TRUE + np.array([0.0, 0.0, 0.4])
    strict = compared(rng, change).fit(LAST).statistic
    lenient = compared(rng, change, allowed=0.1**2).fit(LAST).statistic
    assert lenient < (0.4 + 0.2) ** 2 / 0.1**2 < strict


def test_what_changes_beside_is_no_evidence():
    rng = np.random.default_rng(4)
    beside = ChangeHypothesis("a", ("a",), np.eye(3)[:, :1], beside=np.eye(3)[:, 2:])
    fit = compared(rng, TRUE + np.array([0.0, 0.0, 2.0])).fit(beside)
    assert fit.statistic < 10
    assert fit.size.shape == (1,)


def test_own_noise_is_what_no_plausible_change_explains():
    rng = np.random.default_rng(5)
    own = equations(rng, 2000).own_noise(NOISE, prior=np.full(3, 10.0))
    assert own == pytest.approx(NOISE, rel=0.05)
    stiff = equations(rng, 2000).own_noise(NOISE, prior=np.full(3, 1e-6))
    assert (stiff > 1.5).all()


@pytest.mark.parametrize("statistic", [599.0, 601.0])
def test_tail_is_continuous_at_where_its_form_changes(statistic):
    middle = log_chance(600.0, 4)
    assert log_chance(statistic, 4) == pytest.approx(
        middle + (statistic - 600) / 2, abs=0.02
    )
