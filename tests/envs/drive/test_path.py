"""The way from the commanded torque to the joint."""

from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.drive.path import TorquePath


def _path(joints: int = 1, dt: float = 1e-3, **effects: dict) -> TorquePath:
    """The way to the joints with effects on all of them; those that are 0 are left out."""
    arm = NominalArm("arm", Path("arm.urdf"), tuple("abcdefg"[:joints]))
    applied = [
        AppliedEffect(name, tuple(range(1, joints + 1)), values)
        for name, values in effects.items()
        if any(np.any(value) for value in values.values())
    ]
    return TorquePath(CorrectedArm(arm, tuple(applied)), np.arange(joints), dt)


def _late(delay: float = 0.0, lag: float = 0.0, dt: float = 1e-3) -> TorquePath:
    """One joint with a delay and a lag [s]."""
    times = {"actuator_delay": {"delay": delay}, "actuator_lag": {"time_constant": lag}}
    return _path(dt=dt, **times)


def _response(path: TorquePath, commands: list[float]) -> list[float]:
    return [float(path(np.array([command]))[0]) for command in commands]


@pytest.mark.parametrize(
    ("delay", "expected"),
    [
        (0.0, [0, 1, 1, 1, 1, 1]),
        (1e-3, [0, 0, 1, 1, 1, 1]),
        (3e-3, [0, 0, 0, 0, 1, 1]),
        (2.25e-3, [0, 0, 0, 0.75, 1, 1]),
    ],
)
def test_delay_keeps_the_impulse_of_a_held_torque(
    delay: float, expected: list[float]
) -> None:
    path = _late(delay)
    assert _response(path, [0, 1, 1, 1, 1, 1]) == pytest.approx(expected)


@pytest.mark.parametrize("delay", [0.0, 0.7e-3, 2.25e-3])
def test_step_through_delay_and_lag_by_hand(delay: float) -> None:
    """The mean over each step of 1 - exp(-(t - T) / T_lag), integrated by hand."""
    dt, lag = 1e-3, 4e-3
    path = _late(delay, lag, dt)
    response = _response(path, [0.0, *[1.0] * 12])[1:]
    end = np.maximum(np.arange(1, 13) * dt - delay, 0.0)
    start = np.maximum(np.arange(12) * dt - delay, 0.0)
    area = (end - start) + lag * (np.exp(-end / lag) - np.exp(-start / lag))
    assert response == pytest.approx(area / dt, rel=1e-12)


def test_what_is_clipped_is_clipped_before_it_is_late_and_scaled_behind() -> None:
    path = _path(
        torque_scale={"scale": 0.5},
        actuator_delay={"delay": 0.5e-3},
        torque_saturation={"limit": 2.0},
    )
    assert _response(path, [0, 4, 4]) == pytest.approx([0, 1.5, 3])


def test_arms_side_by_side_may_have_different_effects() -> None:
    """The second of three arms is given a delay and a limit, then a scale instead."""
    path = _path(2).beside(3)
    late = {"actuator_delay": {"delay": 1e-3}, "torque_saturation": {"limit": 2.0}}
    command = np.array([3.0, 3.0, 3.0, 1.0, 3.0, 3.0])
    for effects, expected in (
        (late, [[3, 3, 2, 1, 3, 3], [6, 6, 2, 1, 6, 6], [3, 3, 2, 2, 3, 3]]),
        ({"torque_scale": {"scale": 1.0}}, [[3, 3, 6, 2, 3, 3]]),
    ):
        path.put(1, _path(2, **effects))
        for factor, row in zip((1.0, 2.0, 1.0), expected, strict=False):
            np.testing.assert_allclose(path(factor * command), row)
