"""The way from the commanded torque to the joint."""

import numpy as np
import pytest

from envs.drive.path import TorquePath

ZERO = np.zeros(1)


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
def test_delay_keeps_the_impulse_of_a_held_torque(delay: float, expected: list[float]) -> None:
    path = TorquePath(np.array([delay]), ZERO, ZERO, 1e-3)
    assert _response(path, [0, 1, 1, 1, 1, 1]) == pytest.approx(expected)


def test_first_command_counts_as_held_before() -> None:
    assert _response(TorquePath(np.array([5e-3]), ZERO, ZERO, 1e-3), [7, 1]) == pytest.approx([7, 7])


def test_scale_comes_before_offset() -> None:
    path = TorquePath(np.zeros(2), np.array([0.5, 0.0]), np.array([1.0, -2.0]), 1e-3)
    np.testing.assert_allclose(path(np.array([4.0, 4.0])), [7.0, 2.0])


def test_reset_forgets_commands() -> None:
    path = TorquePath(np.array([2e-3]), ZERO, ZERO, 1e-3)
    _response(path, [1, 2, 3])
    path.reset()
    assert _response(path, [9, 0]) == pytest.approx([9, 9])
