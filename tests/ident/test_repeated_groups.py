"""Repeated groups: variance between them against what they state tells noise from model error."""

from __future__ import annotations

import numpy as np
import pytest

from arm.errors import InputError
from ident.conditioning import low_pass
from ident.estimators.ols import OrdinaryLeastSquares
from ident.problem import Problem
from ident.repeated_groups import compare_groups

BETA = np.array([2.0, -1.0, 0.5])
INTERVAL, LENGTH, GROUPS = 0.02, 600, 6


def slow(rng: np.random.Generator, count: int) -> np.ndarray:
    series = low_pass(rng.standard_normal((LENGTH + 400, count)), 1 / INTERVAL, 1.0)[200:-200]
    return series / series.std(axis=0)


def groups(seed: int, missing: float, *, repeat: bool) -> Problem:
    """Six groups of two joints under noise of 0.2 N m, low-passed at 12 Hz; ``missing`` [N m] times |w_1| w_1 lacks."""
    rng = np.random.default_rng(seed)
    same = slow(rng, 6).reshape(LENGTH, 2, 3)
    W = np.concatenate([same if repeat else slow(rng, 6).reshape(LENGTH, 2, 3) for _ in range(GROUPS)])
    noise = low_pass(rng.standard_normal((len(W), 2)), 1 / INTERVAL, 12.0)
    torque = W @ BETA + 0.2 * noise / noise.std() + missing * np.abs(W[..., 0]) * W[..., 0]
    return Problem(W, torque, ("a", "b", "c"), np.arange(len(W)) // LENGTH, INTERVAL)


def compared(missing: float, *, repeat: bool, runs: int = 20) -> tuple[list[str], np.ndarray]:
    found = [compare_groups(groups(seed, missing, repeat=repeat), OrdinaryLeastSquares()) for seed in range(runs)]
    return [one.verdict for one in found], np.array([one.ratio for one in found])


@pytest.mark.parametrize("repeat", [False, True])
def test_noise_is_called_noise(repeat: bool) -> None:
    verdicts, ratio = compared(0.0, repeat=repeat)
    assert verdicts.count("noise") == len(verdicts)
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.15)


def test_a_missing_effect_makes_groups_of_different_motion_differ() -> None:
    verdicts, ratio = compared(0.3, repeat=False)
    assert set(verdicts) == {"model error that differs between groups"}
    assert np.median(ratio) > 3


def test_a_missing_effect_repeats_with_the_motion() -> None:
    verdicts, ratio = compared(1.0, repeat=True)
    assert set(verdicts) == {"model error common to all groups"}
    assert np.median(ratio) < 0.2


def test_says_what_it_means() -> None:
    bias = compare_groups(groups(0, 0.3, repeat=False), OrdinaryLeastSquares())
    assert "bias that changes with the motion" in bias.warnings[0]
    assert compare_groups(groups(0, 0.0, repeat=False), OrdinaryLeastSquares()).warnings == ()
    assert (bias.between > 2 * bias.stated).any()
    assert bias.values.shape == (GROUPS, 3)


def test_one_group_is_cut_into_four() -> None:
    given = groups(0, 0.0, repeat=False)
    single = Problem(given.matrix, given.torque, given.names, np.zeros(len(given.torque), int), INTERVAL)
    assert len(compare_groups(single, OrdinaryLeastSquares()).values) == 4


def test_a_group_that_is_too_short_is_named() -> None:
    given = groups(0, 0.0, repeat=False)
    group = np.r_[np.zeros(len(given.torque) - 1, int), 1]
    uneven = Problem(given.matrix, given.torque, given.names, group, INTERVAL)
    with pytest.raises(InputError, match="group 2.*too few"):
        compare_groups(uneven, OrdinaryLeastSquares())
