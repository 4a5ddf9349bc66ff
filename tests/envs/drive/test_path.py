"""The way from the commanded torque to the joint."""

from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.drive.laws import TorquePath


def _late(delay: float = 0.0, lag: float = 0.0, dt: float = 1e-3) -> TorquePath:
    """The way to one joint with a delay and a lag [s]."""
    times = {"actuator_delay": {"delay": delay}, "actuator_lag": {"time_constant": lag}}
    applied = [
        AppliedEffect(x, (1,), times[x]) for x in times if any(times[x].values())
    ]
    arm = NominalArm("arm", Path("arm.urdf"), ("hinge",))
    return TorquePath(CorrectedArm(arm, tuple(applied)), np.arange(1), dt)


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
