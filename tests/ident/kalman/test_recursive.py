"""The recursive estimate against batch estimates, and what forgetting and drift do."""

import numpy as np
import pytest
from sweeps import daily

from gapscope.arm.errors import InputError
from gapscope.ident.estimators.wls import WeightedLeastSquares
from gapscope.ident.kalman.recursive import Recursive
from gapscope.ident.model.linear_problem import Problem


def line(count=400, step=0.0, noise=0.1, seed=0):
    """Tau = 2 x + 1 + noise of one joint, the slope changed by ``step`` halfway."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal(count)
    slope = 2.0 + step * (np.arange(count) >= count // 2)
    W = np.stack([x, np.ones(count)], axis=1)[:, None, :]
    tau = (slope * x + 1 + noise * rng.standard_normal(count))[:, None]
    return Problem(W, tau, ("slope", "level"), np.zeros(count, dtype=int), 0.04)


def test_the_last_estimate_is_that_of_weighted_least_squares():
    problem = line()
    batch = np.linalg.lstsq(problem.stacked()[0], problem.stacked()[1], rcond=None)[0]
    recursive = Recursive(np.array([0.1])).estimate(problem)
    assert recursive.value == pytest.approx(batch, abs=1e-5)
    plain = 0.1**2 * np.linalg.inv(problem.stacked()[0].T @ problem.stacked()[0])
    assert recursive.covariance == pytest.approx(plain, rel=1e-3, abs=1e-8)


def test_a_prior_and_one_sample_give_the_textbook_update():
    problem = Problem(
        np.ones((1, 1, 1)), np.array([[3.0]]), ("level",), np.zeros(1, dtype=int), 1.0
    )
    found = Recursive(np.array([1.0]), np.array([1.0]), np.array([[1.0]])).estimate(
        problem
    )
    assert found.value == pytest.approx([2.0])
    assert found.covariance == pytest.approx(np.array([[0.5]]))


def test_innovations_are_white_with_unit_variance_where_the_model_holds():
    track = Recursive(np.array([0.1])).follow(line(2000))
    late = track.innovation[50:, 0]
    assert np.var(late) == pytest.approx(1.0, abs=0.1)
    assert abs(np.mean(late[1:] * late[:-1])) < 0.08


@pytest.mark.parametrize("settings", [{"memory": 1.5}, {"drift": {"slope": 0.5}}])
def test_memory_or_drift_follows_a_change_that_a_constant_parameter_averages(settings):
    problem = line(1000, step=1.0)
    still = Recursive(np.array([0.1])).estimate(problem)
    moving = Recursive(np.array([0.1]), **settings).follow(problem)
    assert 2.3 < still.value[0] < 2.7
    assert moving.of("slope")[0][480] == pytest.approx(2.0, abs=0.15)
    assert moving.of("slope")[0][-1] == pytest.approx(3.0, abs=0.15)


def test_exponential_memory_counts_a_sample_by_its_age():
    tau = np.array([[0.0], [1.0]])
    problem = Problem(np.ones((2, 1, 1)), tau, ("level",), np.zeros(2, dtype=int), 1.0)
    found = Recursive(
        np.array([1.0]), memory=1.0, covariance=np.array([[1e8]])
    ).estimate(problem)
    assert found.value[0] == pytest.approx(1 / (1 + np.exp(-1.0)), rel=1e-6)


def test_smoothing_uses_what_comes_after_and_is_less_uncertain():
    problem = line(600, step=1.0)
    track = Recursive(np.array([0.1]), drift={"slope": 0.5}).follow(problem)
    smooth = track.smoothed()
    truth = 2.0 + (np.arange(600) >= 300)
    error = [
        np.sqrt(np.mean((x.of("slope")[0] - truth)[20:] ** 2)) for x in (track, smooth)
    ]
    assert error[1] < 0.8 * error[0]
    assert (smooth.deviation <= track.deviation * (1 + 1e-9)).all()
    assert smooth.value[:, 1] == pytest.approx(
        np.full(600, track.value[-1, 1]), abs=1e-9
    )


@pytest.mark.parametrize("seed", daily((1, 2), 1))
def test_on_a_recorded_arm_it_agrees_with_the_batch_within_intervals(world, seed):
    problem = world.assembly([world.recorded(seed)])
    batch = WeightedLeastSquares().estimate(problem)
    recursive = Recursive(batch.residual).estimate(problem)
    assert (np.abs(recursive.value - batch.value) < 1.96 * batch.deviation).all()
    assert recursive.deviation == pytest.approx(batch.deviation, rel=0.2)


def test_bad_settings_are_named():
    with pytest.raises(InputError, match="noise"):
        Recursive(np.array([0.1, 0.1])).estimate(line())
    with pytest.raises(InputError, match="weight is no parameter"):
        Recursive(np.array([0.1]), drift={"weight": 1.0}).estimate(line())
    with pytest.raises(InputError, match="2 parameters, the start 3"):
        Recursive(np.array([0.1]), start=np.zeros(3)).estimate(line())
