"""Uncertainty under autocorrelated noise: intervals that hold what they say, where the plain formula does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from sweeps import daily

from gapscope.ident.estimators.by_name import method
from gapscope.ident.estimators.maximum_likelihood import MaximumLikelihood
from gapscope.ident.estimators.ols import OrdinaryLeastSquares
from gapscope.ident.estimators.wls import WeightedLeastSquares
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.uncertainty.intervals import (
    block_jackknife,
    block_length,
    jackknife,
    plain,
    sandwich,
)
from gapscope.ident.uncertainty.model_error import model_error
from gapscope.ident.uncertainty.torque_interval import held_out, torque_interval
from gapscope.model.conditioning import low_pass
from gapscope.model.effective_samples import group_slices

BETA = np.array([2.0, -1.0, 0.5, 3.0])
INTERVAL, SAMPLES, GROUPS = 0.02, 2000, 4


def motion_columns(rng: np.random.Generator, samples: int = SAMPLES) -> np.ndarray:
    """Columns as slow as a motion, below 1 Hz; shape (N, 2, 4)."""
    slow = low_pass(rng.standard_normal((samples + 400, 8)), 1 / INTERVAL, 1.0)[
        200:-200
    ]
    return (slow / slow.std(axis=0)).reshape(samples, 2, 4)


def filtered(rng: np.random.Generator, samples: int = SAMPLES) -> np.ndarray:
    """White noise through a low-pass of 5 Hz, shape (N, 2)."""
    noise = low_pass(rng.standard_normal((samples + 400, 2)), 1 / INTERVAL, 5.0)[
        200:-200
    ]
    return noise / noise.std(axis=0)


def recorded(
    rng: np.random.Generator,
    W: np.ndarray,
    noise: np.ndarray,
    extra: np.ndarray | float = 0.0,
) -> Problem:
    group = np.arange(len(W)) * GROUPS // len(W)
    return Problem(W, W @ BETA + noise + extra, ("a", "b", "c", "d"), group, INTERVAL)


def drawn(seed: int) -> Problem:
    rng = np.random.default_rng(seed)
    return recorded(rng, motion_columns(rng), filtered(rng))


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """Of 320 parameters; the share's own standard deviation is 1.2 %."""
    hits: dict[str, list[np.ndarray]] = {"plain": [], "sandwich": [], "jackknife": []}
    for seed in range(80):
        given = drawn(seed)
        estimate = OrdinaryLeastSquares().estimate(given)
        methods = (
            plain(estimate, given),
            sandwich(given, estimate.value),
            block_jackknife(given, estimate.value),
        )
        for name, uncertainty in zip(hits, methods, strict=True):
            lower, upper = uncertainty.interval(estimate.value)
            hits[name].append((lower <= BETA) & (upper >= BETA))
    coverage = {name: float(np.mean(inside)) for name, inside in hits.items()}
    assert coverage["plain"] < 0.80
    assert 0.91 < coverage["sandwich"] < 0.98
    assert 0.92 < coverage["jackknife"] < 0.985


def autoregressive(rng: np.random.Generator, rho: float) -> np.ndarray:
    """AR(1) noise of unit variance, shape (N, 2)."""
    white = rng.standard_normal((SAMPLES + 200, 2))
    series = lfilter([1.0], [1.0, -rho], white, axis=0)[200:]
    return np.asarray(series) * np.sqrt(1 - rho**2)


@pytest.mark.parametrize(
    "estimator",
    daily(("wls", "maximum_likelihood"), "wls"),
)
def test_intervals_of_identify_hold_the_truth_under_coloured_noise(
    estimator: str,
) -> None:
    """AR(1) 0.8 and short recordings, for which the sandwich holds 88 %; of 600 parameters, with 1 % deviation."""
    hits = []
    for seed in range(150):
        rng = np.random.default_rng(seed)
        columns, noise = motion_columns(rng), autoregressive(rng, 0.8)
        hits.append(holds(recorded(rng, columns, noise).rows(slice(0, 500)), estimator))
    assert 0.92 <= np.mean(hits) <= 0.98


def holds(problem: Problem, name: str) -> np.ndarray:
    """Which parameters are within the interval of a method of ``identify``."""
    used = method(name)
    # least squares needs neither base nor nominal arm
    estimator = {"wls": WeightedLeastSquares, "maximum_likelihood": MaximumLikelihood}[
        name
    ]()
    estimate = estimator.estimate(problem)
    lower, upper = used.interval(problem, estimator, estimate).interval(estimate.value)
    return (lower <= BETA) & (upper >= BETA)


def test_sandwich_agrees_with_a_block_bootstrap() -> None:
    """Deviation over recordings put together from randomly drawn blocks of 40 samples."""
    given, rng = drawn(0), np.random.default_rng(1)
    estimate = OrdinaryLeastSquares().estimate(given)
    starts = np.concatenate(
        [np.arange(s.start, s.stop - 40 + 1) for s in group_slices(given.group)]
    )
    values = []
    for _ in range(120):
        chosen = rng.choice(starts, len(given.torque) // 40)
        rows = (chosen[:, None] + np.arange(40)).ravel()
        sample = replace(
            given,
            matrix=given.matrix[rows],
            torque=given.torque[rows],
            group=np.arange(len(rows)) // 40,
        )
        values.append(OrdinaryLeastSquares().estimate(sample).value)
    assert np.allclose(
        np.std(values, axis=0), sandwich(given, estimate.value).deviation, rtol=0.35
    )


def test_sandwich_of_independent_samples_by_hand() -> None:
    """With blocks of one sample: A^-1 sum (w e)^2 A^-1 N / (N - b); for w = 1, 1, 2 and tau = 0, 2, 3: beta 8 / 6."""
    W = np.array([1.0, 1.0, 2.0])[:, None, None]
    given = Problem(W, np.array([[0.0], [2.0], [3.0]]), ("a",), np.zeros(3, int), 1.0)
    e = np.array([0.0, 2.0, 3.0]) - np.array([1.0, 1.0, 2.0]) * 8 / 6
    expected = (np.array([1.0, 1.0, 2.0]) ** 2 * e**2).sum() / 36 * 3 / 2
    assert sandwich(given, np.array([8 / 6]), length=1).covariance[
        0, 0
    ] == pytest.approx(expected)


def test_sandwich_is_bartletts_sum_of_autocovariances() -> None:
    given = drawn(1)
    beta = OrdinaryLeastSquares().estimate(given).value
    scores = np.einsum("ijb,ij->ib", given.matrix, given.residual(beta))
    meat = np.zeros((4, 4))
    for part in group_slices(given.group):
        for k in range(6):
            lagged = scores[part][k:].T @ scores[part][: len(scores[part]) - k]
            meat += (1 - k / 6) * (lagged if k == 0 else lagged + lagged.T)
    W = given.stacked()[0]
    inverse = np.linalg.inv(W.T @ W)
    expected = inverse @ meat @ inverse * given.torque.size / (given.torque.size - 4)
    assert np.allclose(sandwich(given, beta, length=6).covariance, expected)


def test_jackknife_leaves_out_each_block_in_turn() -> None:
    given = drawn(2)
    beta = OrdinaryLeastSquares().estimate(given).value
    length = SAMPLES // GROUPS
    left_out = np.array(
        [
            OrdinaryLeastSquares().estimate(given.rows(given.group != g)).value
            for g in range(GROUPS)
        ]
    )
    expected = (GROUPS - 1) / GROUPS * (left_out - beta).T @ (left_out - beta)
    assert np.allclose(block_jackknife(given, beta, length=length).covariance, expected)


def test_block_length_grows_with_the_memory() -> None:
    """AR(1) with 0.9: the theory gives G = 2 rho / (1 - rho)^2 g0, g = (1 + rho) / (1 - rho) g0: (1.5 (2 rho / (1 -
    rho^2))^2 N)^(1/3) = 65 samples of 2000; white noise needs a few."""
    rng = np.random.default_rng(0)
    series = rng.standard_normal((2000, 20))
    white = series.copy()
    for i in range(1, len(series)):
        series[i] += 0.9 * series[i - 1]
    group = np.zeros(2000, int)
    assert 30 < block_length(series, group) < 110
    assert block_length(white, group) < 15


class TestModelError:
    """A torque that follows the motion but is no column of the model: 0.5 |w_1| w_1 of the first joint."""

    def pair(self, seed: int, size: float) -> tuple[Problem, np.ndarray, np.ndarray]:
        """A problem with model error, and matrix and torque without noise of another motion."""
        rng = np.random.default_rng(seed)
        W, other = motion_columns(rng), motion_columns(rng)
        missing, lacking = (
            size * np.abs(w[..., 0]) * w[..., 0] * [1.0, 0.0] for w in (W, other)
        )
        return (
            recorded(rng, W, 0.3 * filtered(rng), missing),
            other,
            other @ BETA + lacking,
        )

    def covered(self, size: float, runs: int = 25) -> tuple[float, float, float]:
        """Share of predicted torque within the interval, the same by the plain formula, and of runs warned."""
        hits, bare, warned = [], [], []
        for seed in range(runs):
            given, other, torque = self.pair(seed, size)
            estimate = OrdinaryLeastSquares().estimate(given)
            interval = torque_interval(
                given,
                OrdinaryLeastSquares(),
                block_jackknife(given, estimate.value),
                cutoff=5.0,
            )
            error = np.abs(torque - other @ estimate.value)
            hits.append((error <= interval.half_width(other))[:, 0].mean())
            own = np.einsum("ijb,bc,ijc->ij", other, estimate.covariance, other)
            bare.append((error <= 1.96 * np.sqrt(own))[:, 0].mean())
            warned.append(bool(interval.warnings))
        return float(np.mean(hits)), float(np.mean(bare)), float(np.mean(warned))

    def test_predicted_torque_stays_within_its_interval_and_every_run_warns(
        self,
    ) -> None:
        held, bare, warned = self.covered(0.5)
        assert held > 0.90
        assert bare < 0.5
        assert warned == 1.0

    def test_a_model_without_error_is_hardly_ever_warned_of(self) -> None:
        held, _, warned = self.covered(0.0)
        assert held > 0.90
        assert warned < 0.05

    def test_names_the_joint_and_the_size_of_the_noise(self) -> None:
        given, _, _ = self.pair(0, 0.5)
        error = model_error(given, held_out(given, OrdinaryLeastSquares()), cutoff=5.0)
        assert error.found[0] == 1 and error.p_value[0] < error.p_value[1]
        assert (
            error.systematic[0] > error.systematic[1]
        )  # biased parameters spoil joint 2, too
        assert error.noise == pytest.approx(
            [0.3, 0.3], rel=0.4
        )  # what it has above a quarter of the cut-off is in it
        assert "the residual on joint 1" in error.warnings()[0]

    def test_interval_of_recorded_torque_is_wider(self) -> None:
        given, other, _ = self.pair(0, 0.5)
        interval = torque_interval(
            given, OrdinaryLeastSquares(), block_jackknife(given, BETA), cutoff=5.0
        )
        assert (
            interval.half_width(other, recorded=True) > interval.half_width(other)
        ).all()
        assert (
            interval.half_width(other, 0.99) > interval.half_width(other, 0.9)
        ).all()

    def test_one_group_is_cut_to_hold_some_out(self) -> None:
        given, _, _ = self.pair(0, 0.5)
        single = Problem(
            given.matrix, given.torque, given.names, np.zeros(SAMPLES, int), INTERVAL
        )
        assert np.allclose(
            held_out(single, OrdinaryLeastSquares()),
            held_out(given, OrdinaryLeastSquares()),
        )


def test_jackknife_of_instruments_leaves_blocks_out() -> None:
    """The change of (Z^T W)^-1 Z^T y without each of four blocks of 25 samples, computed outright."""
    rng = np.random.default_rng(4)
    instruments = rng.standard_normal((100, 2, 3))
    regressor = instruments + 0.3 * rng.standard_normal((100, 2, 3))
    torque = regressor @ np.ones(3) + 0.1 * rng.standard_normal((100, 2))

    def solved(rows: np.ndarray) -> np.ndarray:
        left, right = (x[rows].reshape(-1, 3) for x in (instruments, regressor))
        return np.linalg.solve(left.T @ right, left.T @ torque[rows].ravel())

    everything = np.arange(100)
    beta = solved(everything)
    found = jackknife(
        instruments, regressor, torque - regressor @ beta, np.zeros(100, int), 25
    )
    without = [
        solved(np.delete(everything, k + np.arange(25))) for k in range(0, 100, 25)
    ]
    change = np.array(without) - beta
    assert found.covariance == pytest.approx(0.75 * change.T @ change)
    assert found.freedom == 3.0
