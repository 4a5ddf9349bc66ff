"""Repeated groups: variance between them against what they state tells noise from model error."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.trajectory import Fourier, urdf_limits
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import record
from gapscope.ident.estimators.ols import OrdinaryLeastSquares
from gapscope.ident.estimators.wls import WeightedLeastSquares
from gapscope.ident.model.assembly import Assembly
from gapscope.ident.model.base_parameters import structural_base
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.regressor import Regressor
from gapscope.ident.uncertainty.repeated_groups import compare_groups
from gapscope.model.conditioning import low_pass

BETA = np.array([2.0, -1.0, 0.5])
INTERVAL, LENGTH, GROUPS = 0.02, 600, 6


def slow(rng: np.random.Generator, count: int) -> np.ndarray:
    series = low_pass(rng.standard_normal((LENGTH + 400, count)), 1 / INTERVAL, 1.0)[
        200:-200
    ]
    return series / series.std(axis=0)


def groups(seed: int, missing: float, *, repeat: bool) -> Problem:
    """Six groups of two joints under noise of 0.2 N m, low-passed at 12 Hz; ``missing`` [N m] times |w_1| w_1 lacks."""
    rng = np.random.default_rng(seed)
    same = slow(rng, 6).reshape(LENGTH, 2, 3)
    W = np.concatenate(
        [same if repeat else slow(rng, 6).reshape(LENGTH, 2, 3) for _ in range(GROUPS)]
    )
    noise = low_pass(rng.standard_normal((len(W), 2)), 1 / INTERVAL, 12.0)
    torque = (
        W @ BETA + 0.2 * noise / noise.std() + missing * np.abs(W[..., 0]) * W[..., 0]
    )
    return Problem(W, torque, ("a", "b", "c"), np.arange(len(W)) // LENGTH, INTERVAL)


def compared(
    missing: float, *, repeat: bool, runs: int = 20
) -> tuple[list[str], np.ndarray]:
    found = [
        compare_groups(groups(seed, missing, repeat=repeat), OrdinaryLeastSquares())
        for seed in range(runs)
    ]
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
    assert (
        compare_groups(groups(0, 0.0, repeat=False), OrdinaryLeastSquares()).warnings
        == ()
    )
    assert (bias.between > 2 * bias.stated).any()
    assert bias.values.shape == (GROUPS, 3)


def test_one_group_is_cut_into_four() -> None:
    given = groups(0, 0.0, repeat=False)
    single = Problem(
        given.matrix,
        given.torque,
        given.names,
        np.zeros(len(given.torque), int),
        INTERVAL,
    )
    assert len(compare_groups(single, OrdinaryLeastSquares()).values) == 4


def test_a_group_that_is_too_short_is_named() -> None:
    given = groups(0, 0.0, repeat=False)
    group = np.r_[np.zeros(len(given.torque) - 1, int), 1]
    uneven = Problem(given.matrix, given.torque, given.names, group, INTERVAL)
    with pytest.raises(InputError, match="group 2.*too few"):
        compare_groups(uneven, OrdinaryLeastSquares())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("coefficient", "verdict"),
    [(0.0, "noise"), (0.2, "model error that differs between groups")],
)
def test_on_a_simulated_arm(coefficient: float, verdict: str) -> None:
    """Five recordings of three joints under 2 % noise, without and with load friction that the model lacks."""
    pytest.importorskip("pybullet_data")
    sheet = {"armature": [0.3, 0.3, 0.2], "viscous": [4.0, 4.0, 2.0]}
    arm = load_nominal_arm(
        "kuka_iiwa", joints=[f"lbr_iiwa_joint_{j}" for j in (1, 2, 4)], sheet=sheet
    )
    centre, regressor = np.array([0.0, 0.6, -1.2]), Regressor(arm)
    effects = (
        (AppliedEffect("load_friction", (2, 3), {"coefficient": [coefficient] * 2}),)
        if coefficient
        else ()
    )
    limits = urdf_limits(RigidBody(arm), 6.0)._replace(velocity=np.full(3, 1.3))
    recordings = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        motion = Fourier.random(rng, limits, duration=8.0, centre=centre, frequency=0.2)
        one = record(
            arm,
            effects,
            motion,
            position_controller(arm, centre),
            duration=8.0,
            rng=rng,
        )
        tau = np.asarray(one.tau)
        noise = 0.02 * tau.std(axis=0) * rng.standard_normal(tau.shape)
        recordings.append(Recording(one.name, one.t, one.q, tau + noise))
    base = structural_base(regressor, np.random.default_rng(0))
    problem = Assembly(regressor, base, position_cutoff=20.0, every=5)(recordings)
    assert compare_groups(problem, WeightedLeastSquares()).verdict == verdict
