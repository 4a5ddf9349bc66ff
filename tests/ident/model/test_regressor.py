"""The regressor: against the inverse dynamics, finite differences of the corrected arm, and other joint orders."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import tooled_panda
from cases import panda_body, panda_case, sines

from gapscope.arm.case import Case
from gapscope.arm.coupling import coupling_of_transmission
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect, drives_with
from gapscope.effects.catalogue import of_quantity
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.model.base_parameters import (
    ROWS,
    JointFactors,
    TriangularFactor,
    factored,
    random_states,
    structural_base,
)
from gapscope.ident.model.friction import PULLS, STRONGEST, Choice, choose
from gapscope.ident.model.linear_problem import FrictionLaw, ModelColumns, drives
from gapscope.ident.model.regressor import JOINT_COLUMNS, Regressor
from gapscope.ident.samples import Band, Samples, split

SHEET = {
    "armature": np.arange(1, 8) / 10,
    "coulomb": np.arange(1, 8) / 2,
    "viscous": np.arange(1, 8) / 3,
}


@pytest.fixture(scope="module")
def arm() -> NominalArm:
    return load_nominal_arm("kuka_iiwa", sheet=SHEET)


@pytest.fixture(scope="module")
def motion() -> Motion:
    rng = np.random.default_rng(0)
    t = np.arange(60) / 100
    phase, size = rng.uniform(0, 6, 7), rng.uniform(0.5, 1.5, 7)
    return sines(t, size, 3.0, phase)


def test_nominal_parameters_give_the_torque_of_the_nominal_arm(arm, motion):
    regressor = Regressor(arm)
    predicted = CorrectedArm(arm).predict(regressor.body, motion)
    assert (
        np.abs(regressor.matrix(motion) @ regressor.nominal() - predicted).max()
        < 1e-10 * np.abs(predicted).max()
    )


def test_inertial_columns_give_the_inverse_dynamics(arm, motion):
    regressor = Regressor(arm, quantities=())
    torque = regressor.body.inverse_dynamics(motion.q, motion.dq, motion.ddq)
    assert (
        np.abs(regressor.matrix(motion) @ regressor.nominal() - torque).max()
        < 1e-10 * np.abs(torque).max()
    )


@pytest.mark.parametrize("name", JOINT_COLUMNS)
def test_column_of_a_quantity_is_the_derivative_of_the_predicted_torque(
    arm, motion, name
):
    regressor = Regressor(arm)
    Y, step, joints = regressor.matrix(motion), 1e-3, tuple(range(1, 8))
    symbol = of_quantity(name)[0].parameters[0].symbol
    for joint in (1, 4, 7):
        predicted = []
        for sign in (-1, 1):
            value = sign * step * (np.array(joints) == joint)
            effect = drives_with(joints, **{name: value})
            predicted.append(
                CorrectedArm(arm, (effect,)).predict(regressor.body, motion)
            )
        slope = (predicted[1] - predicted[0]) / (2 * step)
        column = Y[:, :, regressor.names.index(f"{symbol}{joint}")]
        assert np.abs(slope).max() > 0.1
        assert np.allclose(column, slope, rtol=0, atol=1e-8)


def test_inertial_column_is_the_derivative_of_the_inverse_dynamics(arm, motion):
    regressor, step = Regressor(arm), 1e-3
    Y = regressor.matrix(motion)
    for place in (30, 31, 44, 69):
        more = np.zeros(70)
        more[place] = step
        low, high = (
            regressor.body.changed(sign * more.reshape(7, 10)).inverse_dynamics(
                motion.q, motion.dq, motion.ddq
            )
            for sign in (-1, 1)
        )
        assert np.allclose(Y[:, :, place], (high - low) / (2 * step), rtol=0, atol=1e-8)


def test_joints_in_another_order_permute_rows_and_columns(arm, motion):
    order = np.array([3, 0, 6, 1, 5, 2, 4])
    shuffled = NominalArm(arm.name, arm.urdf, tuple(arm.joints[i] for i in order))
    there = Motion(motion.t, *(x[:, order] for x in (motion.q, motion.dq, motion.ddq)))
    Y = (
        Regressor(NominalArm(arm.name, arm.urdf, arm.joints))
        .matrix(motion)
        .reshape(-1, 7, 98)
    )
    columns = np.concatenate(
        [
            (10 * order[:, None] + np.arange(10)).ravel(),
            *(70 + 7 * k + order for k in range(4)),
        ]
    )
    assert np.allclose(
        Regressor(shuffled).matrix(there),
        Y[:, order][:, :, columns],
        rtol=0,
        atol=1e-12,
    )


@pytest.mark.parametrize("order", [[0, 1, 2, 3, 4, 5, 6], [3, 0, 6, 1, 5, 2, 4]])
def test_support_covers_every_entry_and_leaves_out_links_not_carried(
    arm, motion, order
):
    shuffled = NominalArm(arm.name, arm.urdf, tuple(arm.joints[i] for i in order))
    regressor = Regressor(shuffled)
    there = Motion(motion.t, *(x[:, order] for x in (motion.q, motion.dq, motion.ddq)))
    used = (regressor.matrix(there) != 0).any(axis=0)
    assert (used <= regressor.support).all()
    assert regressor.support.sum() == 10 * (7 * 8 // 2) + 4 * 7


def test_regressor_fills_an_array_that_is_given(arm, motion):
    regressor = Regressor(arm)
    room = np.full((60, 7, 98), np.nan)
    assert regressor.matrix(motion, room) is room
    assert np.array_equal(room, regressor.matrix(motion))


def test_last_link_has_the_last_columns(arm, motion):
    body = RigidBody(arm)
    full = body.regressor(motion.q, motion.dq, motion.ddq)
    assert np.array_equal(
        body.last_link_regressor(motion.q, motion.dq, motion.ddq), full[:, :, 60:]
    )


def test_quantity_without_a_column_is_refused(arm):
    with pytest.raises(
        InputError,
        match="(?s)play is no quantity with a regressor column.*choose among rotor",
    ):
        Regressor(arm, quantities=("play",))


# The columns of the pipeline: friction with memory, coupled motors, and agreement with the catalogue's effects.


def random_motion(rng: np.random.Generator, n: int = 7, count: int = 40) -> Motion:
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, count, n))
    return Motion(np.arange(count) / 100, q, dq, ddq)


class TestDrives:
    def test_uncoupled_arm_has_its_joints(self) -> None:
        ratios = np.diag([10.0, -20.0] * 3 + [30.0])
        arm = replace(tooled_panda(), coupling=coupling_of_transmission(ratios))
        matrix, labels = drives(arm)
        np.testing.assert_array_equal(matrix, np.eye(7))
        assert labels == tuple("1234567")

    def test_coupled_motor_turns_with_both_joints(self) -> None:
        """Motor 3 turns 40 times for one turn of joint 3 and 20 times for one of joint 2, joint 2 counted backwards."""
        transmission = np.array([[10.0, 0, 0], [0, 20.0, 0], [0, 20.0, 40.0]])
        signs = np.array([1.0, -1.0, 1.0])
        matrix = coupling_of_transmission(transmission, signs)
        np.testing.assert_allclose(matrix, [[1, 0, 0], [0, 1, 0], [0, -0.5, 1]])

    def test_friction_of_a_coupled_motor_takes_power(self) -> None:
        """The torque of motor friction times joint speeds is b times the motor's speed squared, on joint 3's side."""
        rng = np.random.default_rng(1)
        coupling = np.eye(7)
        coupling[6, 5] = 0.5
        columns = ModelColumns(
            replace(tooled_panda(), coupling=coupling), body=panda_body()
        )
        assert columns.coupled == ("7m",)
        motion, law = random_motion(rng), FrictionLaw()
        place = columns.names(law).index("b7m")
        power = (columns.matrix(motion, law)[:, :, place] * motion.dq).sum(axis=1)
        np.testing.assert_allclose(
            power, (motion.dq[:, 6] + 0.5 * motion.dq[:, 5]) ** 2, atol=1e-12
        )


def test_columns_give_the_torque_of_the_corrected_arm() -> None:
    """Randomised: nominal arm with offsets, Stribeck and saturating friction by the catalogue, and by the columns."""
    rng = np.random.default_rng(2)
    speeds = rng.uniform(0.1, 1.0, 7)
    law = FrictionLaw(stribeck_speed=0.3, saturation_speeds=tuple(speeds.tolist()))
    motion = random_motion(rng)
    columns = ModelColumns(tooled_panda(), panda_body())
    joints = tuple(range(1, 7 + 1))
    offset = rng.uniform(-1, 1, 7)
    drop, level = rng.uniform(0, 1, (2, 7))
    effects = (
        AppliedEffect("torque_offset", joints, {"torque": offset}),
        AppliedEffect(
            "stribeck_friction",
            joints,
            {"torque": drop, "velocity": np.full(7, 0.3)},
        ),
        AppliedEffect(
            "saturating_friction", joints, {"torque": level, "velocity": speeds}
        ),
    )
    x = columns.nominal(law)
    names = columns.names(law)
    for j in range(7):
        for symbol, values in (("o", offset), ("d", drop), ("s", level)):
            x[names.index(f"{symbol}{j + 1}")] = values[j]
    expected = CorrectedArm(tooled_panda(), effects).predict(panda_body(), motion)
    np.testing.assert_allclose(columns.matrix(motion, law) @ x, expected, atol=1e-8)
    assert (
        len(names)
        == len(set(names))
        == len(columns.units(law))
        == len(columns.scale(law))
    )


def test_scale_is_the_size_of_each_body() -> None:
    columns = ModelColumns(tooled_panda(), panda_body())
    scale, law = columns.scale(FrictionLaw()), FrictionLaw()
    assert (scale > 0).all() and np.isfinite(scale[: 10 * 7]).all()
    assert np.isinf(scale[10 * 7 :]).all()
    assert scale[0] == pytest.approx(columns.nominal(law)[0])
    assert Path(tooled_panda().urdf).is_file()


# The pull to the nominal arm: stronger ones are tried as long as they predict better.


def chosen(case: Case) -> tuple[Choice, list[float]]:
    fit, _ = split(case)
    band = Band(20.0)
    choice = choose(
        Samples(ModelColumns(case.arm), band.segments(fit), band),
        nonlinear=False,
        presliding=False,
    )
    return choice, [float(what.split("pull ")[1]) for what, _ in choice.tried[1:]]


def test_right_bodies_are_pulled_to_as_strongly_as_can_be() -> None:
    choice, tried = chosen(panda_case())
    assert max(tried) > max(PULLS)
    assert choice.pull in (max(tried), max(tried) / 10) and max(tried) <= STRONGEST


def test_wrong_bodies_are_not() -> None:
    choice, tried = chosen(
        panda_case(
            (AppliedEffect("payload", (), {"mass": 3.0, "com": [0.0, 0.0, 0.1]}),)
        )
    )
    assert tried == pytest.approx(PULLS)
    assert choice.pull < max(PULLS)


# Streaming least squares: the same as factoring all rows at once, whatever the chunks.


@pytest.fixture
def problem():
    rng = np.random.default_rng(0)
    W = rng.standard_normal((3 * ROWS + 17, 12)) * 10 ** rng.uniform(-3, 3, 12)
    return W, W @ rng.uniform(1, 2, 12) + rng.standard_normal(len(W))


def streamed(W, tau, chunk) -> TriangularFactor:
    factor = TriangularFactor(W.shape[1])
    for start in range(0, len(W), chunk):
        factor.add(W[start : start + chunk], tau[start : start + chunk])
    return factor


def assert_same(factor, W, tau):
    """R^T R = W^T W, R^T z = W^T tau, and the least-squares solution, relative to the size of each."""
    R, scale = factor.triangle, np.linalg.norm(W, axis=0)
    assert np.array_equal(R, np.triu(R))
    assert np.allclose(
        R.T @ R / np.outer(scale, scale),
        W.T @ W / np.outer(scale, scale),
        rtol=0,
        atol=1e-12,
    )
    size = scale * np.linalg.norm(tau)
    assert np.allclose(
        R.T @ factor.projected / size, W.T @ tau / size, rtol=0, atol=1e-12
    )
    beta, square = np.linalg.lstsq(W, tau, rcond=None)[:2]
    assert np.linalg.norm(factor.solve() - beta) < 1e-10 * np.linalg.norm(beta)
    assert factor.residual_norm**2 == pytest.approx(square[0], rel=1e-10)
    assert factor.rows == len(W)


@pytest.mark.parametrize("chunk", [1, 5, 700, ROWS, 10**6])
def test_least_squares_of_a_stream_is_that_of_all_rows(problem, chunk):
    W, tau = problem if chunk > 5 else (problem[0][:300], problem[1][:300])
    assert_same(streamed(W, tau, chunk), W, tau)


def test_merged_factors_are_the_factor_of_all_rows(problem):
    W, tau = problem
    first, second = (
        streamed(W[:1000], tau[:1000], 300),
        streamed(W[1000:], tau[1000:], 450),
    )
    first.merge(second)
    assert_same(first, W, tau)


def test_factor_of_some_columns(problem):
    W, tau = problem
    columns = [7, 2, 11]
    assert_same(streamed(W, tau, 500).select(columns), W[:, columns], tau)


def test_scaled_factor_is_that_of_weighted_rows(problem):
    W, tau = problem
    assert_same(streamed(W, tau, 500).scaled(-2.5), 2.5 * W, 2.5 * tau)


def test_covariance_is_the_textbook_formula(problem):
    W, tau = problem
    beta = np.linalg.lstsq(W, tau, rcond=None)[0]
    expected = np.sum((tau - W @ beta) ** 2) / (len(W) - 12) * np.linalg.inv(W.T @ W)
    assert np.allclose(streamed(W, tau, 500).covariance(), expected, rtol=1e-9, atol=0)


def test_dependent_columns_give_the_shortest_solution():
    rng = np.random.default_rng(1)
    W = rng.standard_normal((50, 3)) @ np.array(
        [[1.0, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 1]]
    )
    tau = rng.standard_normal(50)
    assert np.allclose(
        streamed(W, tau, 10).solve(),
        np.linalg.lstsq(W, tau, rcond=1e-12)[0],
        rtol=0,
        atol=1e-12,
    )


def test_orthogonal_factor_keeps_what_the_normal_equations_lose():
    # singular values 1 and 1e-9: their squares are beyond double precision
    rng = np.random.default_rng(2)
    left, right = (
        np.linalg.qr(rng.standard_normal((5000, 2)))[0],
        np.linalg.qr(rng.standard_normal((2, 2)))[0],
    )
    W = left * [1.0, 1e-9] @ right.T
    beta = streamed(W, W @ [1.0, -2.0], 400).solve()
    assert np.allclose(beta, [1.0, -2.0], rtol=0, atol=1e-5)


@pytest.fixture(scope="module")
def iiwa():
    regressor = Regressor(load_nominal_arm("kuka_iiwa"))
    states = random_states(regressor, np.random.default_rng(3), 400)
    Y = regressor.matrix(states)
    tau = Y @ regressor.nominal() + np.random.default_rng(4).standard_normal(
        (400, 7)
    ) * np.arange(1, 8)
    return regressor, Y, tau


def test_factors_of_joints_stacked_with_weights_solve_the_weighted_problem(iiwa):
    regressor, Y, tau = iiwa
    base = structural_base(regressor, np.random.default_rng(5))
    joints = JointFactors(regressor.support)
    for start in range(0, 400, 90):
        joints.add(Y[start : start + 90], tau[start : start + 90])
    weights = 1.0 / np.arange(1, 8)
    rows = (Y[:, :, base.kept] * weights[:, None]).reshape(-1, base.count)
    assert_same(
        joints.stacked(weights).select(base.kept), rows, (tau * weights).ravel()
    )
    plain = Y[:, :, base.kept].reshape(-1, base.count)
    assert_same(joints.stacked().select(base.kept), plain, tau.ravel())


def test_factors_of_joints_merge(iiwa):
    regressor, Y, tau = iiwa
    parts = [JointFactors(regressor.support) for _ in range(2)]
    parts[0].add(Y[:150], tau[:150])
    parts[1].add(Y[150:], tau[150:])
    parts[0].merge(parts[1])
    whole = JointFactors(regressor.support)
    whole.add(Y, tau)
    for merged, direct in zip(parts[0].joints, whole.joints, strict=True):
        assert merged.rows == direct.rows == 400
        products = [factor.triangle.T @ factor.triangle for factor in (merged, direct)]
        assert np.allclose(*products, rtol=0, atol=1e-12 * np.abs(products[0]).max())
        assert merged.residual_norm == pytest.approx(direct.residual_norm, rel=1e-8)


@pytest.mark.parametrize("samples", [60, ROWS + 30])
def test_factors_of_a_motion_are_those_of_its_regressor(iiwa, samples):
    regressor = iiwa[0]
    states = random_states(regressor, np.random.default_rng(6), samples)
    Y, tau = (
        regressor.matrix(states),
        np.random.default_rng(7).standard_normal((samples, 7)),
    )
    stacked = factored(regressor, states, tau).stacked()
    base = structural_base(regressor, np.random.default_rng(8))
    assert_same(
        stacked.select(base.kept),
        Y[:, :, base.kept].reshape(-1, base.count),
        tau.ravel(),
    )


def test_memory_does_not_grow_with_the_number_of_rows(problem):
    W, tau = (x[:ROWS] for x in problem)
    factor = TriangularFactor(12)
    factor.add(W, tau)
    tracemalloc.start()
    peaks = []
    for repeats in (5, 50):
        tracemalloc.reset_peak()
        for _ in range(repeats):
            factor.add(W, tau)
        peaks.append(tracemalloc.get_traced_memory()[1])
    tracemalloc.stop()
    assert factor.rows == 56 * ROWS
    assert peaks[1] < 1.1 * peaks[0]


BAD = {
    "columns": (np.ones((4, 3)), None, "expected 2 columns, got 3"),
    "torques": (np.ones((4, 2)), np.ones(5), "4 rows of the regressor, but 5 torques"),
    "NaN in the regressor": (np.full((4, 2), np.nan), None, "not finite"),
    "NaN in the torque": (np.eye(4, 2), np.full(4, np.nan), "not finite"),
}


@pytest.mark.parametrize(("W", "tau", "message"), BAD.values(), ids=BAD)
def test_bad_rows_are_refused(W, tau, message):
    with pytest.raises(InputError, match=message):
        TriangularFactor(2).add(W, tau)


def test_refused_rows_leave_the_factor_as_it_was(problem):
    W, tau = problem
    factor = streamed(W, tau, 500)
    with pytest.raises(InputError, match="not finite"):
        factor.add(np.full((3, 12), np.inf))
    assert_same(factor, W, tau)
