"""Partial update: a simulated iiwa's parameters carried over to an arm with other friction and masses 10 % larger."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Fourier, urdf_limits
from gapscope.arm.robots import load_nominal_arm
from gapscope.ident.estimators.ols import OrdinaryLeastSquares
from gapscope.ident.estimators.partial_update import PartialUpdate
from gapscope.ident.model.base_parameters import BaseParameters, base_parameters
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.regressor import Regressor
from gapscope.model.conditioning import low_pass

SHEET = {
    "armature": [0.6, 0.6, 0.35, 0.35, 0.2, 0.1, 0.08],
    "coulomb": [3.0, 3.5, 2.0, 2.5, 1.2, 0.8, 0.5],
    "viscous": [4.0, 4.0, 2.5, 2.5, 1.5, 1.0, 0.6],
}
RATE = 50.0
NOISE = 0.05


@dataclass(frozen=True)
class Transfer:
    """A simulated arm as prior, and the real arm."""

    regressor: Regressor
    base: BaseParameters
    prior: np.ndarray
    truth: np.ndarray

    def problem(self, duration: float, noise: float, seed: int) -> Problem:
        """A random Fourier motion with low-passed torque noise, as a share of each joint's standard deviation."""
        rng = np.random.default_rng(seed)
        limits = urdf_limits(RigidBody(self.regressor.arm), 5.0)
        limits = limits._replace(velocity=np.full(7, 1.5))
        reference = Fourier.random(rng, limits, duration=max(duration, 10.0), ramp=0.5)
        t = np.arange(round(duration * RATE)) / RATE + 0.5
        matrix = self.regressor.matrix(
            Motion(
                t,
                reference.position(t),
                reference.velocity(t),
                reference.acceleration(t),
            )
        )[..., self.base.kept]
        torque = matrix @ self.truth
        white = low_pass(rng.standard_normal((len(t) + 100, 7)), RATE, 12.0)[50:-50]
        names = [self.regressor.names[i] for i in self.base.kept]
        torque = torque + noise * torque.std(axis=0) * white / white.std()
        return Problem(matrix, torque, names, np.zeros(len(t), int), 1 / RATE)


@pytest.fixture(scope="module")
def transfer() -> Transfer:
    regressor = Regressor(load_nominal_arm("kuka_iiwa", sheet=SHEET))
    rng = np.random.default_rng(0)
    q, dq, ddq = (rng.standard_normal((300, 7)) for _ in range(3))
    base = base_parameters(
        regressor.matrix(Motion(0.01 * np.arange(300), q, dq, ddq)).reshape(2100, -1),
        regressor.names,
    )
    simulated = regressor.nominal()
    real = simulated.copy()
    real[:70] *= 1.1
    friction = slice(77, 91)
    real[friction] *= rng.uniform(0.5, 1.6, 14)
    return Transfer(regressor, base, base.of(simulated), base.of(real))


def judged(transfer: Transfer, duration: float, seeds: range) -> dict[str, float]:
    """Mean RMSE of the torque on an unseen motion of 20 s without noise [N m], by estimate."""
    errors: dict[str, list[float]] = {
        "prior": [],
        "full refit": [],
        "partial update": [],
    }
    for seed in seeds:
        given, other = (
            transfer.problem(duration, NOISE, seed),
            transfer.problem(20.0, 0.0, 1000 + seed),
        )
        values = {
            "prior": transfer.prior,
            "full refit": OrdinaryLeastSquares().estimate(given).value,
            "partial update": PartialUpdate(transfer.prior).estimate(given).value,
        }
        for name, value in values.items():
            errors[name].append(float(np.sqrt((other.residual(value) ** 2).mean())))
    return {name: float(np.mean(found)) for name, found in errors.items()}


def test_beats_prior_and_full_refit_on_little_data(transfer: Transfer) -> None:
    """Three seconds of motion; mean RMSE of the torque on unseen motions, five draws."""
    found = judged(transfer, 3.0, range(5))
    assert found["partial update"] < 0.75 * found["prior"]
    assert found["partial update"] < 0.5 * found["full refit"]


def test_comes_to_what_a_full_refit_gives_on_much_data(transfer: Transfer) -> None:
    found = judged(transfer, 30.0, range(2))
    assert found["partial update"] < 1.1 * found["full refit"]
    assert found["partial update"] < 0.2 * found["prior"]


def test_moves_the_influential_and_holds_the_rest(transfer: Transfer) -> None:
    """The friction of moving joints is told by the data; what is held keeps prior value and prior spread."""
    given = transfer.problem(3.0, NOISE, 0)
    spread = 0.2 * np.abs(transfer.prior) + 0.01
    update = PartialUpdate(transfer.prior, spread)
    estimate = update.estimate(given)
    moved = dict(zip(given.names, update.moved(estimate), strict=True))
    assert all(moved[f"c{joint}"] for joint in (1, 2, 3, 4))
    held = ~update.moved(estimate)
    assert 0 < held.sum() < len(held)
    assert np.array_equal(estimate.value[held], transfer.prior[held])
    assert np.allclose(estimate.deviation[held], spread[held])
    assert (estimate.deviation[~held] < spread[~held]).all()


def test_one_parameter_by_hand() -> None:
    """A prior 1 +- 1 and nine samples of 3 under noise s: (1 + 9 * 3 / s^2) / (1 + 9 / s^2)."""
    W = np.ones((9, 1, 1))
    W[:4] = 1 + 1e-7
    tau = 3.0 + np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 0.0])[:, None]
    given = Problem(W, tau, ("p",), np.zeros(9, int), 1.0)
    estimate = PartialUpdate(np.ones(1), np.ones(1)).estimate(given)
    left = tau - estimate.value[0]
    variance = (left**2).mean() * 9 / 8
    assert estimate.value[0] == pytest.approx(
        (1 + 27 / variance) / (1 + 9 / variance), rel=1e-4
    )
    assert estimate.covariance[0, 0] == pytest.approx(1 / (1 + 9 / variance), rel=1e-4)


def test_a_prior_that_does_not_fit_is_refused(transfer: Transfer) -> None:
    with pytest.raises(InputError, match="one per parameter"):
        PartialUpdate(np.ones(3), np.ones(3)).estimate(transfer.problem(3.0, NOISE, 0))


def test_says_when_nothing_moves(transfer: Transfer) -> None:
    given = transfer.problem(3.0, NOISE, 0)
    estimate = PartialUpdate(
        transfer.prior, np.full(len(transfer.prior), 1e-9)
    ).estimate(given)
    assert np.array_equal(estimate.value, transfer.prior)
    assert "move no parameter" in estimate.warnings[-1]
