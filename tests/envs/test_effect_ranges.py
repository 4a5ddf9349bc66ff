"""Ranges of effects: intervals, several units, what is physically possible, the file, and the draw."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.effect_ranges import (
    EffectRange,
    EffectRanges,
    effect_range,
    read_effect_ranges,
    spread,
    within_nominal,
    write_effect_ranges,
)
from gapscope.envs.environment import ArmTracking


def friction(joints: tuple[int, ...], low: list, high: list) -> EffectRange:
    both = {"torque": low}, {"torque": high}
    ends = (AppliedEffect("coulomb_friction", joints, x) for x in both)
    return EffectRange(*ends)


def test_friction_of_the_data_sheet_is_not_undone_below_zero() -> None:
    arm = replace(load_nominal_arm("kuka_iiwa"), coulomb=np.array([1.0] + [0.0] * 6))
    ranges = within_nominal([friction((1, 2), [-3.0, -3.0], [2.0, 2.0])], arm)
    assert ranges.ranges[0].low.parameters["torque"].tolist() == [-1.0, 0.0]
    assert ranges.ranges[0].high.parameters["torque"].tolist() == [2.0, 2.0]


def test_several_units_are_all_held_and_absence_is_zero() -> None:
    units = [
        [friction((1, 2), [2.0, 3.0], [2.5, 3.5])],
        [friction((2,), [4.0], [5.0])],
        [],
    ]
    (found,) = spread(units)
    assert found.low.joints == (1, 2)
    assert found.low.parameters["torque"].tolist() == [0.0, 0.0]
    assert found.high.parameters["torque"].tolist() == [2.5, 5.0]
    (both,) = spread(units[:2])
    assert both.low.parameters["torque"].tolist() == [0.0, 3.0]


def test_a_limit_comes_from_the_units_that_have_it() -> None:
    ends = (AppliedEffect("torque_saturation", (3,), {"limit": [x]}) for x in (18, 22))
    (found,) = spread([[EffectRange(*ends)], []])
    assert found.low.parameters["limit"].tolist() == [18.0]


def test_the_file_is_read_back(tmp_path: Path) -> None:
    payload = AppliedEffect("payload", (), {"mass": 1.0, "com": [0.1, 0.0, -0.1]})
    stds = {"mass": np.array(0.1), "com": np.full(3, 0.01)}
    both = effect_range(payload, stds), friction((1,), [1.0], [2.0])
    write_effect_ranges(EffectRanges(both), tmp_path / "ranges.yaml", "# head\n")
    again = read_effect_ranges(tmp_path / "ranges.yaml").ranges
    assert str(again) == str(both)


RANGE = "ranges: [{{effect: {}, joints: [1], low: {{torque: [{}]}}, high: {{torque: [2]}}}}]\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("schema: 1\n", "ranges"),
        ("ranges: [{effect: coulomb_friction}]\n", "low: and high:"),
        (RANGE.format("coulomb_friction", 3), "higher in low:"),
        (RANGE.format("coulomb_frictio", 1), "coulomb_friction"),
    ],
)
def test_a_bad_file_is_told(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "ranges.yaml").write_text(text)
    with pytest.raises(InputError, match=message) as error:
        read_effect_ranges(tmp_path / "ranges.yaml")
    assert "ranges.yaml" in str(error.value)


def test_the_environment_draws_all_of_them_at_each_reset() -> None:
    ranges = EffectRanges((friction((1, 4), [1.0, 2.0], [3.0, 2.0]),))
    env = ArmTracking(episode_length=0.1, randomisation=ranges, debug=True)
    drawn = []
    for seed in (1, 2, 1):
        _, info = env.reset(seed=seed)
        (effect,) = info["effects"]
        drawn.append(np.array(effect["parameters"]["torque"]))
    assert 1.0 <= drawn[0][0] <= 3.0 and drawn[0][1] == 2.0
    assert drawn[0][0] != drawn[1][0] and drawn[0].tolist() == drawn[2].tolist()
