"""Physically consistent estimators: bodies that can be, whatever the noise, and torque as well explained."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.robots import load_nominal_arm
from gapscope.ident.estimators.consistent_sdp import ConsistentSdp
from gapscope.ident.estimators.estimate import Estimator
from gapscope.ident.estimators.log_cholesky import LogCholesky
from gapscope.ident.estimators.ols import OrdinaryLeastSquares
from gapscope.ident.model.base_parameters import base_parameters
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.pseudo_inertia import is_consistent, triangle_inequality
from gapscope.ident.model.regressor import Regressor

LINKS = 3
SHEET = {
    "armature": [0.3, 0.3, 0.2],
    "coulomb": [3.0, 3.0, 2.0],
    "viscous": [4.0, 4.0, 2.0],
}


@pytest.fixture(scope="module")
def regressor() -> Regressor:
    joints = [f"lbr_iiwa_joint_{joint}" for joint in (1, 2, 4)]
    return Regressor(load_nominal_arm("kuka_iiwa", joints=joints, sheet=SHEET))


def sampled(
    regressor: Regressor, noise: float, samples: int = 200, seed: int = 0
) -> Problem:
    """Random states of the nominal arm with white torque noise [N m], in standard columns."""
    rng = np.random.default_rng(seed)
    q, dq, ddq = (
        scale * rng.standard_normal((samples, LINKS)) for scale in (1.0, 1.0, 3.0)
    )
    Y = regressor.matrix(Motion(0.01 * np.arange(samples), q, dq, ddq))
    torque = Y @ regressor.nominal()
    return Problem(
        Y,
        torque + noise * rng.standard_normal(torque.shape),
        regressor.names,
        np.zeros(samples, int),
        0.01,
    )


def bodies(value: np.ndarray) -> np.ndarray:
    return value[: 10 * LINKS].reshape(LINKS, 10)


def estimators(prior: np.ndarray) -> dict[str, Estimator]:
    return {
        "sdp": ConsistentSdp(),
        "sdp euclidean": ConsistentSdp(prior),
        "sdp entropic": ConsistentSdp(prior, "entropic"),
        "log-cholesky": LogCholesky(),
        "log-cholesky with prior": LogCholesky(prior),
    }


NAMES = tuple(estimators(np.zeros(1)))
PULLED = ("sdp euclidean", "sdp entropic", "log-cholesky with prior")


@pytest.mark.parametrize("noise", [0.1, 5.0])
@pytest.mark.parametrize("name", NAMES)
def test_bodies_are_physical_and_friction_is_not_negative(
    regressor: Regressor, name: str, noise: float
) -> None:
    given = sampled(regressor, noise, samples=60)
    value = estimators(1.1 * regressor.nominal())[name].estimate(given).value
    assert (
        is_consistent(bodies(value)).all() and triangle_inequality(bodies(value)).all()
    )
    assert (value[10 * LINKS : 13 * LINKS] >= 0).all()


def test_ordinary_least_squares_gives_bodies_that_cannot_be(
    regressor: Regressor,
) -> None:
    """Otherwise the test above shows nothing: the same data, spread over standard parameters, give no bodies."""
    given = sampled(regressor, 3.0, samples=60)
    base = base_parameters(sampled(regressor, 0.0).stacked()[0], regressor.names)
    reduced = Problem(
        given.matrix[..., base.kept],
        given.torque,
        [given.names[i] for i in base.kept],
        given.group,
        given.interval,
    )
    beta = OrdinaryLeastSquares().estimate(reduced).value
    assert not is_consistent(bodies(base.nearest(beta, regressor.nominal()))).all()


@pytest.mark.parametrize("name", NAMES)
def test_without_noise_the_torque_is_explained(regressor: Regressor, name: str) -> None:
    given = sampled(regressor, 0.0)
    estimate = estimators(1.1 * regressor.nominal())[name].estimate(given)
    assert estimate.residual.max() < 0.01 * given.torque.std()


@pytest.mark.parametrize("name", PULLED)
def test_with_noise_other_torque_is_predicted_better_than_without_constraints(
    regressor: Regressor, name: str
) -> None:
    """On little and noisy data; mean over three draws of the RMSE on 200 other states."""
    other = sampled(regressor, 0.0, seed=99)
    base = base_parameters(other.stacked()[0], regressor.names)
    own, plain = [], []
    for seed in range(3):
        given = sampled(regressor, 3.0, samples=30, seed=seed)
        value = estimators(1.1 * regressor.nominal())[name].estimate(given).value
        reduced = Problem(
            given.matrix[..., base.kept],
            given.torque,
            [given.names[i] for i in base.kept],
            given.group,
            0.01,
        )
        beta = base.spread(OrdinaryLeastSquares().estimate(reduced).value)
        own.append(np.sqrt((other.residual(value) ** 2).mean()))
        plain.append(np.sqrt((other.residual(beta) ** 2).mean()))
    assert np.mean(own) < 0.7 * np.mean(plain)


@pytest.mark.parametrize("name", PULLED)
def test_what_data_do_not_tell_comes_from_the_prior(
    regressor: Regressor, name: str
) -> None:
    """The mass of link 1, about a vertical axis, never shows in the torque; its prior is 1.1 of the truth."""
    prior = 1.1 * regressor.nominal()
    value = estimators(prior)[name].estimate(sampled(regressor, 0.1)).value
    assert value[0] == pytest.approx(prior[0], rel=0.1)


@pytest.mark.parametrize(
    "name", ["sdp euclidean", "sdp entropic", "log-cholesky with prior"]
)
def test_a_strong_pull_gives_the_prior(regressor: Regressor, name: str) -> None:
    prior = 1.1 * regressor.nominal()
    strong = {
        "sdp euclidean": ConsistentSdp(prior, weight=1e9),
        "sdp entropic": ConsistentSdp(prior, "entropic", weight=1e9),
        "log-cholesky with prior": LogCholesky(prior, weight=1e9),
    }[name]
    value = strong.estimate(sampled(regressor, 0.1)).value
    assert np.allclose(bodies(value), bodies(prior), rtol=1e-2, atol=1e-2)


@pytest.mark.parametrize("name", NAMES)
def test_parameters_that_data_tell_lie_within_their_stated_errors(
    regressor: Regressor, name: str
) -> None:
    """Friction and offsets, 9 of them: none further off than four deviations."""
    value = estimators(1.1 * regressor.nominal())[name].estimate(
        sampled(regressor, 1.0, 400)
    )
    places = slice(11 * LINKS, 14 * LINKS)
    scaled = (value.value - regressor.nominal())[places] / value.deviation[places]
    assert np.abs(scaled).max() < 4.0


class TestRefuses:
    def test_base_columns(self) -> None:
        W = np.random.default_rng(0).standard_normal((50, 1, 2))
        given = Problem(W, W @ np.ones(2), ("mx1", "b1"), np.zeros(50, int), 0.01)
        for estimator in (ConsistentSdp(), LogCholesky()):
            with pytest.raises(InputError, match="standard parameters"):
                estimator.estimate(given)

    def test_a_prior_that_is_no_body(self, regressor: Regressor) -> None:
        prior = regressor.nominal().copy()
        prior[10] = -1.0
        for estimator in (ConsistentSdp(prior), LogCholesky(prior)):
            with pytest.raises(InputError, match="m2 and its link is no physical body"):
                estimator.estimate(sampled(regressor, 0.1))

    def test_an_entropic_pull_to_nothing(self, regressor: Regressor) -> None:
        with pytest.raises(InputError, match="needs a prior"):
            ConsistentSdp(pull="entropic").estimate(sampled(regressor, 0.1))

    def test_samples_that_are_not_finite(self, regressor: Regressor) -> None:
        given = sampled(regressor, 0.1)
        given.torque[3, 2] = np.inf
        for estimator in (ConsistentSdp(), LogCholesky()):
            with pytest.raises(InputError, match="sample 4, joint 3"):
                estimator.estimate(given)


def test_torque_in_newton_millimetres_is_suspected(regressor: Regressor) -> None:
    given = sampled(regressor, 0.1)
    wrong = Problem(
        given.matrix, 1e3 * given.torque, given.names, given.group, given.interval
    )
    assert (
        "suspiciously large"
        in ConsistentSdp(regressor.nominal()).estimate(wrong).warnings[0]
    )
