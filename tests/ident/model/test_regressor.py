"""The regressor: against the inverse dynamics, finite differences of the corrected arm, and other joint orders."""

import numpy as np
import pytest
from cases import sines

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import drives_with
from gapscope.effects.catalogue import of_quantity
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.model.regressor import JOINT_COLUMNS, Regressor

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
