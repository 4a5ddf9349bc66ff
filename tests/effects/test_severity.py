"""Severities drawn at random."""

import numpy as np
import pytest

from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.severity import draw, possible


@pytest.fixture(scope="module", params=["kuka_iiwa", "franka_panda", "xarm6"])
def arm(request: pytest.FixtureRequest):
    return load_nominal_arm(request.param)


def test_every_effect_is_drawn_within_its_bounds_and_from_the_seed_alone(arm) -> None:
    scale = ArmScale.of(arm)
    for name in CATALOGUE:
        first, second = (
            [draw(name, np.random.default_rng(seed), scale) for seed in range(20)]
            for _ in range(2)
        )
        for one, other in zip(first, second, strict=True):
            assert one.joints == other.joints and len(one.joints) <= 2
            for key in one.parameters:
                np.testing.assert_array_equal(
                    one.parameters[key], other.parameters[key]
                )
        key = "mass" if "mass" in first[0].parameters else CATALOGUE[name].names[0]
        assert (
            len({np.atleast_1d(one.parameters[key]).tolist()[0] for one in first}) > 3
        )


@pytest.mark.parametrize(
    ("name", "parameter"),
    [("stribeck_friction", "velocity"), ("encoder_quantization", "step")],
)
def test_what_does_not_depend_on_the_arm_covers_what_is_met_on_real_arms(
    arm, name: str, parameter: str
) -> None:
    """The whole of the catalogue's typical range, and nothing beyond it."""
    scale, rng = ArmScale.of(arm), np.random.default_rng(0)
    drawn = np.concatenate(
        [draw(name, rng, scale).parameters[parameter] for _ in range(300)]
    )
    low, high = CATALOGUE[name].parameter(parameter).typical
    assert low <= 1.01 * drawn.min() and drawn.max() <= 1.01 * high
    assert drawn.min() < 1.1 * low and drawn.max() > 0.9 * high


def test_joints_may_be_chosen(arm) -> None:
    assert draw(
        "backlash", np.random.default_rng(0), ArmScale.of(arm), joints=(5, 2)
    ).joints == (2, 5)


def test_a_motor_of_its_own_needs_rotors(arm) -> None:
    assert set(CATALOGUE) - set(possible(arm)) == {"joint_elasticity", "backlash"}
