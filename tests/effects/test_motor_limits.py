"""Motors at their edge: torque that falls with the speed and with heat, in files and in numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from gapscope.arm.motions.motion import Motion
from gapscope.effects.catalogue import effect
from gapscope.effects.corrected_file import described, read_entry
from gapscope.effects.signals import MotionSeries

LIMIT, CORNER, NO_LOAD = 8.0, 1.0, 3.0


def series(*speeds: float) -> MotionSeries:
    """Joints that turn at one speed each [rad/s]."""
    t = np.arange(0.0, 40.0, 0.01)
    dq = np.ones((len(t), 1)) * speeds
    return MotionSeries(Motion(t, t[:, None] * dq, dq, 0.0 * dq))


DELIVERED = [
    (0.5, 20.0, LIMIT),
    (CORNER, 20.0, LIMIT),
    (2.0, 20.0, LIMIT / 2),
    (2.0, 3.0, 3.0),
    (NO_LOAD, 20.0, 0.0),
    (5.0, 20.0, 0.0),
    (2.0, -20.0, -LIMIT),
    (-2.0, 20.0, LIMIT),
    (-2.0, -20.0, -LIMIT / 2),
]
"""Speed [rad/s], torque that is asked for and that is delivered [N m], of a joint each."""


def test_torque_along_the_velocity_falls_and_torque_that_brakes_does_not() -> None:
    speed, torque, delivered = np.transpose(DELIVERED)
    at, law = series(*speed), effect("torque_saturation").applied
    asked, edge = np.ones_like(at.position) * torque, (LIMIT, CORNER, NO_LOAD)
    values = [np.full(len(speed), x) for x in edge]
    np.testing.assert_allclose(law(asked, at, *values)[5], delivered, atol=1e-12)
    flat = law(asked, at, values[0])[5]
    np.testing.assert_allclose(flat, np.clip(torque, -LIMIT, LIMIT))


def test_a_warm_motor_gives_less_and_needs_more() -> None:
    scale, at = effect("torque_scale"), series(0.0)
    values = [np.array([x]) for x in (0.1, 0.2, 5.0, 4.0)]
    u = np.full_like(at.position, 5.0)
    applied = scale.applied(u, at, *values)
    cold = 1.0 - 0.2 * (1.0 - np.exp(-np.arange(len(u)) * 0.01 / 4.0))
    np.testing.assert_allclose(applied[:, 0], 1.1 * 5.0 * cold, rtol=1e-3)
    np.testing.assert_allclose(scale.inverse(applied, at, *values), u, rtol=1e-3)


@pytest.mark.parametrize(
    ("name", "plain", "further"),
    [
        ("torque_saturation", {"limit": [5.0]}, {"no_load_speed": [3.0]}),
        ("torque_scale", {"scale": [0.1]}, {"fading": [0.1], "rated": [5.0]}),
    ],
)
def test_files_without_them_read_and_are_written_as_before(
    name: str, plain: dict[str, list[float]], further: dict[str, list[float]]
) -> None:
    for parameters in (plain, plain | further):
        entry = {"effect": name, "joints": [2], "parameters": parameters}
        read = read_entry(yaml.safe_load(yaml.safe_dump(entry)), "effects[1]", Path())
        assert set(read.given) == set(parameters)
        assert described(read) == entry
