"""The columns of the pipeline: friction with memory, coupled motors, and agreement with the catalogue's effects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import tooled_panda
from cases import panda_body

from gapscope.arm.coupling import coupling_of_transmission
from gapscope.arm.motions.motion import Motion
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.model.friction_law import FrictionLaw, drives
from gapscope.ident.model.model_columns import ModelColumns


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
