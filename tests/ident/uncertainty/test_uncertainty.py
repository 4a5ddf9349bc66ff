"""Uncertainty under autocorrelated noise: intervals that hold what they say, where the plain formula does not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from sweeps import daily

from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.ident.estimators.by_name import method
from gapscope.ident.estimators.linear import ordinary_least_squares
from gapscope.ident.identification import errors, validate
from gapscope.ident.intervals import (
    block_jackknife,
    compare_groups,
    torque_interval,
    whiteness,
)
from gapscope.ident.samples import Problem
from gapscope.model.conditioning import Segment, low_pass
from gapscope.model.rows import DecimatedSegments

BETA = np.array([2.0, -1.0, 0.5, 3.0])
INTERVAL, SAMPLES, GROUPS = 0.02, 2000, 4


def low(
    rng: np.random.Generator, count: int, cutoff: float, samples: int
) -> np.ndarray:
    """White noise through a low-pass [Hz], of unit variance, shape (N, count)."""
    white = rng.standard_normal((samples + 400, count))
    series = low_pass(white, 1 / INTERVAL, cutoff)[200:-200]
    return series / series.std(axis=0)


def motion_columns(rng: np.random.Generator, samples: int = SAMPLES) -> np.ndarray:
    """Columns as slow as a motion, below 1 Hz; shape (N, 2, 4)."""
    return low(rng, 8, 1.0, samples).reshape(samples, 2, 4)


def filtered(rng: np.random.Generator, samples: int = SAMPLES) -> np.ndarray:
    """Noise below 5 Hz, shape (N, 2)."""
    return low(rng, 2, 5.0, samples)


def every(W: np.ndarray) -> np.ndarray:
    """``INTERVAL`` for each sample."""
    return np.full(len(W), INTERVAL)


def recorded(
    rng: np.random.Generator, W: np.ndarray, noise: np.ndarray, extra: Any = 0.0
) -> Problem:
    group = np.arange(len(W)) * GROUPS // len(W)
    return Problem(W, W @ BETA + noise + extra, ("a", "b", "c", "d"), group, every(W))


def least_squares(given: Problem) -> tuple[Any, Any]:
    """The estimate, and the interval of the torque that it predicts."""
    estimate = ordinary_least_squares(given)
    blocks = block_jackknife(given, estimate.value)
    return estimate, torque_interval(given, ordinary_least_squares, blocks, cutoff=5.0)


def autoregressive(rng: np.random.Generator, rho: float) -> np.ndarray:
    """AR(1) noise of unit variance, shape (N, 2)."""
    white = rng.standard_normal((SAMPLES + 200, 2))
    series = lfilter([1.0], [1.0, -rho], white, axis=0)[200:]
    return np.asarray(series) * np.sqrt(1 - rho**2)


@pytest.mark.parametrize("name", daily(("wls", "maximum_likelihood"), "wls"))
def test_intervals_of_identify_hold_the_truth_under_coloured_noise(name: str) -> None:
    """AR(1) 0.8 and short recordings; of 600 parameters, with 1 % deviation."""
    used, hits = method(name), []
    # least squares needs neither base nor nominal arm
    estimator = used.make(None)  # type: ignore[arg-type]
    for seed in range(150):
        rng = np.random.default_rng(seed)
        given = recorded(rng, motion_columns(rng), autoregressive(rng, 0.8))
        given = given.rows(slice(0, 500))
        estimate = estimator(given)
        interval = used.interval(given, estimator, estimate)
        lower, upper = interval.interval(estimate.value)
        hits.append((lower <= BETA) & (upper >= BETA))
    assert 0.92 <= np.mean(hits) <= 0.98


def covered(size: float, runs: int = 25) -> np.ndarray:
    """Share of predicted torque within the interval, the same by the plain formula, and of runs warned, (3,).

    A part of the torque follows the motion but is no column of the model: ``size`` |w_1| w_1 of the first joint. It is
    predicted for another motion, without noise.
    """
    found = []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        W, other = motion_columns(rng), motion_columns(rng)
        missing, lacking = (
            size * np.abs(w[..., 0]) * w[..., 0] * [1.0, 0.0] for w in (W, other)
        )
        given = recorded(rng, W, 0.3 * filtered(rng), missing)
        estimate, interval = least_squares(given)
        error = np.abs(other @ (BETA - estimate.value) + lacking)
        own = np.einsum("ijb,bc,ijc->ij", other, estimate.covariance, other)
        widths = interval.half_width(other), 1.96 * np.sqrt(own)
        shares = [(error <= width)[:, 0].mean() for width in widths]
        found.append([*shares, bool(interval.warnings())])
    return np.mean(found, axis=0)


def test_model_error_stays_within_the_interval_of_the_torque_and_is_warned_of() -> None:
    held, bare, warned = covered(0.5)
    assert held > 0.90 and bare < 0.5 and warned == 1.0
    # without error a model is hardly ever warned of
    held, _, warned = covered(0.0)
    assert held > 0.90 and warned < 0.05


def test_intervals_count_a_form_that_repeats_with_the_motion() -> None:
    """A function of 48 draws that is no column, little noise: the blocks alone hold about half of 192 parameters."""
    hits: dict[str, list[np.ndarray]] = {"blocks": [], "form": []}
    scaled = []
    for seed in range(48):
        rng = np.random.default_rng(seed)
        W = motion_columns(rng)
        # the same five functions of the first column in every group, and so in every block
        state = np.tanh(W[..., :1])
        functions = np.cos(state * np.arange(1.0, 6.0) + np.arange(5.0))
        lacking = 0.3 * functions @ rng.standard_normal(5)
        given = recorded(rng, W, 0.01 * filtered(rng), lacking)
        beta = ordinary_least_squares(given).value
        for name, forms in (("blocks", ()), ("form", (functions,))):
            uncertainty = block_jackknife(replace(given, forms=forms), beta)
            lower, upper = uncertainty.interval(beta)
            hits[name].append((lower <= BETA) & (upper >= BETA))
        scaled.append((beta - BETA) / uncertainty.deviation)
    held = {name: float(np.mean(inside)) for name, inside in hits.items()}
    assert held["blocks"] < 0.85
    assert held["form"] > 0.90
    # and are no wider than the errors that are made
    assert np.sqrt(np.mean(np.square(scaled))) > 0.6


def test_few_samples_are_not_taken_for_an_effect_that_is_lacking() -> None:
    """Groups that do not determine each other's columns miss each other by more than noise, without any lack."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        # each group moves by a column of its own
        own = 0.02 + np.eye(4)[np.arange(160) * 4 // 160]
        W = motion_columns(rng, 160) * own[:, None, :]
        _, interval = least_squares(recorded(rng, W, 0.1 * filtered(rng, 160)))
        assert not interval.warnings()


# Repeated groups: variance between them against what they state tells noise from model error.


THREE = BETA[:3]
LENGTH, REPEATED_GROUPS = 600, 6


def groups(seed: int, missing: float, *, repeat: bool) -> Problem:
    """Six groups of two joints under noise of 0.2 N m, low-passed at 12 Hz; ``missing`` [N m] times |w_1| w_1 lacks."""
    rng = np.random.default_rng(seed)
    parts = [low(rng, 6, 1.0, LENGTH) for _ in range(1 if repeat else REPEATED_GROUPS)]
    W = np.concatenate(parts * (REPEATED_GROUPS if repeat else 1)).reshape(-1, 2, 3)
    noise = low_pass(rng.standard_normal((len(W), 2)), 1 / INTERVAL, 12.0)
    torque = W @ THREE + 0.2 * noise / noise.std()
    torque += missing * np.abs(W[..., 0]) * W[..., 0]
    group = np.arange(len(W)) // LENGTH
    return Problem(W, torque, ("a", "b", "c"), group, every(W))


@pytest.mark.parametrize(
    ("missing", "repeat", "verdict", "low", "high"),
    [
        (0.0, False, "noise", 0.85, 1.15),
        (0.0, True, "noise", 0.85, 1.15),
        (0.3, False, "model error that differs between groups", 3.0, np.inf),
        (1.0, True, "model error common to all groups", 0.0, 0.2),
    ],
)
def test_groups_tell_noise_from_an_effect_that_is_missing(
    missing: float, repeat: bool, verdict: str, low: float, high: float
) -> None:
    """In 20 draws; it makes groups of different motion differ, and repeats with the motion."""
    draws = (groups(seed, missing, repeat=repeat) for seed in range(20))
    found = [compare_groups(draw, ordinary_least_squares) for draw in draws]
    assert {one.verdict for one in found} == {verdict}
    assert low < np.mean([one.ratio for one in found]) < high
    if verdict.endswith("between groups"):
        assert "bias that changes with the motion" in found[0].meaning
        assert (found[0].std_between ** 2 > 2 * found[0].stated_std ** 2).any()


def test_a_group_that_is_too_short_is_named() -> None:
    given = groups(0, 0.0, repeat=False)
    group = np.r_[np.zeros(len(given.torque) - 1, int), 1]
    uneven = replace(given, group=group)
    with pytest.raises(InputError, match="group 2.*too few"):
        compare_groups(uneven, ordinary_least_squares)


# Errors of a prediction, and whether what is left is noise.


def test_errors_by_hand() -> None:
    torque = np.array([[3.0, 1.0], [4.0, 1.0], [0.0, 1.0], [0.0, 1.0]])
    predicted = torque - [[1.0, 0.0], [1.0, 0.0], [1.0, 0.0], [-1.0, 2.0]]
    found = errors(torque, predicted, np.full((4, 2), True))
    np.testing.assert_allclose(found.rmse, [1.0, 1.0])
    np.testing.assert_allclose(found.relative, [1 / 2.5, 1.0])
    np.testing.assert_allclose(found.largest, [1.0, 2.0])
    assert found.overall == pytest.approx(np.sqrt(8 / 29))


def test_noise_in_the_band_is_white_and_what_follows_the_motion_is_not() -> None:
    rate, cutoff = 250.0, 20.0
    noise = np.random.default_rng(0).standard_normal((20_000, 40))
    wave = 0.5 * np.sin(2 * np.pi * 0.4 * np.arange(20_000) / rate)[:, None]
    p_values = []
    for residual in (noise, wave + noise[:, :1]):
        left = low_pass(residual, rate, cutoff)
        group, rates = np.zeros(len(left), dtype=int), np.full(len(left), rate)
        p_values.append(whiteness(left, group, rates, cutoff).p_value)
    assert (p_values[0] > 0.001).mean() > 0.95
    assert (p_values[0] < 0.5).mean() == pytest.approx(0.5, abs=0.2)
    assert p_values[1][0] < 1e-3


def test_same_filter_on_both_sides() -> None:
    """A model that is right up to what the filter takes away leaves nothing."""
    t = np.arange(1000)[:, None] / 250
    torque = np.sin(2 * np.pi * 3 * t) + np.sign(np.sin(2 * np.pi * t))
    motion = Motion(t[:, 0], t, np.ones((1000, 1)), np.zeros((1000, 1)))
    both = DecimatedSegments([Segment("made.csv", motion, torque)] * 2, 5.0)
    found = validate("judge", both, lambda m: torque, lambda m: 0.9 * torque)
    assert found.every.overall < 1e-12 and found.nominal.overall == pytest.approx(0.1)
    assert found.recordings == ("made.csv",) and len(found.edges) == 3
    assert len(found.t) == 2 * (1000 - 2 * 75)
