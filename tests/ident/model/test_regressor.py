"""The regressor: against the inverse dynamics, finite differences of the corrected arm, and other joint orders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import tooled_panda
from cases import panda_body, panda_case, sines

from gapscope.arm.case import Case
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect, drives_with
from gapscope.effects.catalogue import of_quantity
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.model.regressor import JOINT_COLUMNS, Regressor
from gapscope.ident.samples import (
    PULLS,
    FrictionLaw,
    ModelColumns,
    Samples,
    choose,
    split,
)

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


@pytest.mark.parametrize("name", JOINT_COLUMNS)
def test_column_of_a_quantity_is_the_derivative_of_the_predicted_torque(
    arm, motion, name
):
    regressor, step = Regressor(arm), 1e-3
    Y = regressor.matrix(motion)
    symbol = of_quantity(name)[0].parameters[0].symbol
    for joint in (1, 4, 7):
        values = step * (np.arange(1, 8) == joint)
        effects = (
            drives_with(tuple(range(1, 8)), **{name: s * values}) for s in (-1, 1)
        )
        arms = (CorrectedArm(arm, (effect,)) for effect in effects)
        down, up = (x.predict(regressor.body, motion) for x in arms)
        slope = (up - down) / (2 * step)
        column = Y[:, :, regressor.names.index(f"{symbol}{joint}")]
        assert np.abs(slope).max() > 0.1
        assert np.allclose(column, slope, rtol=0, atol=1e-8)


def test_joints_in_another_order_permute_rows_and_columns(arm, motion):
    order = np.array([3, 0, 6, 1, 5, 2, 4])
    there = Motion(motion.t, *(x[:, order] for x in (motion.q, motion.dq, motion.ddq)))
    plain, shuffled = (
        Regressor(NominalArm(arm.name, arm.urdf, tuple(arm.joints[i] for i in way)))
        for way in (range(7), order)
    )
    bodies = (10 * order[:, None] + np.arange(10)).ravel()
    columns = np.r_[bodies, (70 + 7 * np.arange(4)[:, None] + order).ravel()]
    expected = plain.matrix(motion)[:, order][:, :, columns]
    assert np.allclose(shuffled.matrix(there), expected, rtol=0, atol=1e-12)


# The columns of the pipeline: friction with memory, coupled motors, and agreement with the catalogue's effects.


def random_motion(rng: np.random.Generator, n: int = 7, count: int = 40) -> Motion:
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, count, n))
    return Motion(np.arange(count) / 100, q, dq, ddq)


def test_friction_of_a_coupled_motor_takes_power() -> None:
    """The torque of motor friction times joint speeds is b times the motor's speed squared, on joint 3's side."""
    coupling = np.eye(7)
    coupling[6, 5] = 0.5
    arm = replace(tooled_panda(), coupling=coupling)
    columns = ModelColumns(arm, body=panda_body())
    assert columns.coupled == ("7m",)
    motion, law = random_motion(np.random.default_rng(1)), FrictionLaw()
    place = columns.names(law).index("b7m")
    power = (columns.matrix(motion, law)[:, :, place] * motion.dq).sum(axis=1)
    speed = motion.dq[:, 6] + 0.5 * motion.dq[:, 5]
    np.testing.assert_allclose(power, speed**2, atol=1e-12)


def test_columns_give_the_torque_of_the_corrected_arm() -> None:
    """Randomised: nominal arm with offsets, Stribeck and saturating friction by the catalogue, and by the columns."""
    rng, joints = np.random.default_rng(2), tuple(range(1, 8))
    speeds = rng.uniform(0.1, 1.0, 7)
    law = FrictionLaw(stribeck_speed=0.3, saturation_speeds=tuple(speeds.tolist()))
    motion = random_motion(rng)
    columns = ModelColumns(tooled_panda(), panda_body())
    offset = rng.uniform(-1, 1, 7)
    drop, level = rng.uniform(0, 1, (2, 7))
    stribeck = {"torque": drop, "velocity": np.full(7, 0.3)}
    saturating = {"torque": level, "velocity": speeds}
    effects = (
        AppliedEffect("torque_offset", joints, {"torque": offset}),
        AppliedEffect("stribeck_friction", joints, stribeck),
        AppliedEffect("saturating_friction", joints, saturating),
    )
    x, names = columns.nominal(law), columns.names(law)
    for symbol, values in (("o", offset), ("d", drop), ("s", level)):
        x[[names.index(f"{symbol}{j}") for j in joints]] = values
    expected = CorrectedArm(tooled_panda(), effects).predict(panda_body(), motion)
    np.testing.assert_allclose(columns.matrix(motion, law) @ x, expected, atol=1e-8)
    assert len(set(names)) == len(names)
    assert len(names) == len(columns.units(law)) == len(columns.scale(law))


# The pull to the nominal arm: as strong as predicts best.


def chosen(case: Case) -> float:
    fit, _ = split(case)
    samples = Samples(ModelColumns(case.arm), fit, 20.0)
    return choose(samples, nonlinear=False, presliding=False).pull


def test_right_bodies_are_pulled_to_as_strongly_as_can_be_and_wrong_ones_are_not() -> (
    None
):
    wrong = AppliedEffect("payload", (), {"mass": 3.0, "com": [0.0, 0.0, 0.1]})
    assert chosen(panda_case()) >= PULLS[-2]
    assert chosen(panda_case((wrong,))) < 10.0
