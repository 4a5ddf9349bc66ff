"""The way from the commanded torque to the joint."""

import numpy as np
import pytest

from gapscope.envs.drive.path import TorquePath

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
def test_delay_keeps_the_impulse_of_a_held_torque(
    delay: float, expected: list[float]
) -> None:
    path = TorquePath(np.array([delay]), ZERO, ZERO, 1e-3)
    assert _response(path, [0, 1, 1, 1, 1, 1]) == pytest.approx(expected)


def test_first_command_counts_as_held_before() -> None:
    assert _response(
        TorquePath(np.array([5e-3]), ZERO, ZERO, 1e-3), [7, 1]
    ) == pytest.approx([7, 7])


def test_scale_comes_before_offset() -> None:
    path = TorquePath(np.zeros(2), np.array([0.5, 0.0]), np.array([1.0, -2.0]), 1e-3)
    np.testing.assert_allclose(path(np.array([4.0, 4.0])), [7.0, 2.0])


def test_reset_forgets_commands() -> None:
    path = TorquePath(np.array([2e-3]), ZERO, ZERO, 1e-3)
    _response(path, [1, 2, 3])
    path.reset()
    assert _response(path, [9, 0]) == pytest.approx([9, 9])


def _gain(path: TorquePath, frequency: float, dt: float) -> complex:
    """Output over input of a sine [Hz], after it has settled, by projection on the input over whole periods."""
    w = 2 * np.pi * frequency
    periods = int(np.ceil(1.0 * frequency))
    t = np.arange(round((periods + int(frequency) + 1) / frequency / dt)) * dt
    out = np.array([float(path(np.array([np.sin(w * x)]))[0]) for x in t])
    inside = t >= t[-1] + dt - periods / frequency
    return complex(2 * np.mean((out * np.exp(-1j * w * t))[inside]) * 1j)


@pytest.mark.parametrize("frequency", [1.0, 5.0, 20.0])
@pytest.mark.parametrize(
    ("delay", "lag"),
    [(0.0, 0.01), (0.0, 0.03), (0.0023, 0.0), (0.0125, 0.0), (0.0047, 0.008)],
)
def test_frequency_response_of_delay_and_lag(
    delay: float, lag: float, frequency: float
) -> None:
    """Out / in = exp(-j w T) / (1 + j w T_lag), within 1 % at 20 Hz and steps of 1 ms."""
    w, dt = 2 * np.pi * frequency, 1e-3
    path = TorquePath(np.array([delay]), ZERO, ZERO, dt, lag=np.array([lag]))
    expected = np.exp(-1j * w * delay) / (1 + 1j * w * lag)
    assert abs(_gain(path, frequency, dt) / expected - 1) < 0.01 * (w * dt / 0.126)


@pytest.mark.parametrize("delay", [0.0, 0.7e-3, 2.25e-3])
def test_step_through_delay_and_lag_by_hand(delay: float) -> None:
    """The mean over each step of 1 - exp(-(t - T) / T_lag), integrated by hand."""
    dt, lag = 1e-3, 4e-3
    path = TorquePath(np.array([delay]), ZERO, ZERO, dt, lag=np.array([lag]))
    response = _response(path, [0.0, *[1.0] * 12])[1:]
    end = np.maximum(np.arange(1, 13) * dt - delay, 0.0)
    start = np.maximum(np.arange(12) * dt - delay, 0.0)
    area = (end - start) + lag * (np.exp(-end / lag) - np.exp(-start / lag))
    assert response == pytest.approx(area / dt, rel=1e-12)


def test_saturation_clips_what_was_commanded() -> None:
    path = TorquePath(
        np.zeros(2), np.array([0.5, 0.0]), ZERO, 1e-3, limit=np.array([4.0, 0.0])
    )
    np.testing.assert_allclose(path(np.array([9.0, 9.0])), [6.0, 9.0])
    np.testing.assert_allclose(path(np.array([-9.0, -9.0])), [-6.0, -9.0])


def test_ripple_goes_by_the_motors_position() -> None:
    """2 sin(3 q + 0.5): at q = pi / 6 - 1 / 6 it is 2 N m."""
    ripple = (np.array([2.0]), np.array([3.0]), np.array([0.5]))
    path = TorquePath(ZERO, ZERO, ZERO, 1e-3, ripple=ripple)
    assert path(np.array([1.0]), np.array([(np.pi / 2 - 0.5) / 3])) == pytest.approx(
        [3.0]
    )
    assert not path.constant
