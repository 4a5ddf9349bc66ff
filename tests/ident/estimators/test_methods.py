"""Each estimator with the interval that belongs to it."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.ident.estimators.by_name import METHODS, Given, method
from gapscope.ident.estimators.experiment import Experiment
from gapscope.ident.estimators.ols import OrdinaryLeastSquares
from gapscope.ident.estimators.on_base import OnBase
from gapscope.ident.estimators.ridge import Ridge
from gapscope.ident.model.base_parameters import BaseParameters
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.uncertainty.refit_jackknife import refit_jackknife

TRUTH = np.array([1.0, -2.0, 0.5])
LINEAR = (
    "consistent",
    "wls",
    "ols",
    "irls",
    "ridge",
    "l_curve",
    "truncated_svd",
    "total_least_squares",
    "maximum_likelihood",
)


def problem(seed: int, outliers: bool = False) -> Problem:
    rng = np.random.default_rng(seed)
    matrix = rng.standard_normal((300, 2, 3))
    noise = 0.1 * rng.standard_normal((300, 2))
    if outliers:
        noise[::20] *= 30.0
    return Problem(
        matrix, matrix @ TRUTH + noise, ("a", "b", "c"), np.arange(300) // 150, 0.01
    )


def given_by(base: BaseParameters) -> Given:
    def experiment() -> Experiment:
        raise AssertionError("a linear estimator does not simulate")

    return Given(base, TRUTH, experiment)


@pytest.mark.parametrize("name", LINEAR)
def test_intervals_hold_the_truth(name: str) -> None:
    chosen, base = (
        METHODS[name],
        BaseParameters(("a", "b", "c"), np.arange(3), np.eye(3)),
    )
    hits = []
    for seed in range(40):
        given = problem(seed)
        estimator = chosen.make(given_by(base))
        estimate = estimator.estimate(given)
        low, high = chosen.interval(given, estimator, estimate).interval(estimate.value)
        hits.append((low <= TRUTH) & (high >= TRUTH))
    assert 0.88 <= np.mean(hits) <= 1.0


def test_an_interval_is_its_own_estimators() -> None:
    """With outliers Huber's estimate is far more exact than least squares, and says so."""
    base, given = (
        BaseParameters(("a", "b", "c"), np.arange(3), np.eye(3)),
        problem(0, outliers=True),
    )
    width = {}
    for name in ("ols", "irls"):
        estimator = METHODS[name].make(given_by(base))
        width[name] = (
            METHODS[name]
            .interval(given, estimator, estimator.estimate(given))
            .deviation
        )
    assert (width["irls"] < 0.5 * width["ols"]).all()


def test_refit_jackknife_is_that_of_the_estimator() -> None:
    given = problem(1)
    free, held = (
        refit_jackknife(given, OrdinaryLeastSquares()),
        refit_jackknife(given, Ridge(1e3)),
    )
    assert (held.deviation < 0.5 * free.deviation).all()
    assert free.freedom == 19


def test_base_parameters_of_an_estimator_of_all() -> None:
    base = BaseParameters(
        ("a", "b", "c", "z"),
        np.arange(3),
        np.column_stack([np.eye(3), [0.5, 0.0, 0.0]]),
    )
    found = OnBase(Ridge(), base).estimate(problem(2))
    np.testing.assert_allclose(found.value, TRUTH, atol=0.02)
    assert found.covariance.shape == (3, 3)


def test_unknown_name() -> None:
    with pytest.raises(InputError, match="unknown estimator 'magic'") as caught:
        method("magic")
    assert all(name in caught.value.remedy for name in METHODS)
