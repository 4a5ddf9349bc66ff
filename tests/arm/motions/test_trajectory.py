"""Reference motions keep their limits, start and end at rest, and their derivatives are derivatives."""

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.arm.motions.trajectory import Fourier, Limits

LIMITS = Limits(
    np.array([-1.0, -2.0]),
    np.array([1.5, 0.5]),
    np.array([0.8, 2.0]),
    np.array([3.0, 40.0]),
)


def _motion(seed: int = 0, **options: object) -> Fourier:
    return Fourier.random(
        np.random.default_rng(seed), LIMITS, **({"duration": 12.0} | options)
    )


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("frequency", [0.1, 0.4])
def test_limits_hold_and_one_is_met(seed: int, frequency: float) -> None:
    motion, t = _motion(seed, frequency=frequency), np.linspace(0, 12, 12001)
    q, dq, ddq = motion.position(t), motion.velocity(t), motion.acceleration(t)
    room = np.minimum(LIMITS.upper - motion.centre, motion.centre - LIMITS.lower)
    use = [np.abs(q - motion.centre).max(0) / room, np.abs(dq).max(0) / LIMITS.velocity]
    use.append(np.abs(ddq).max(0) / LIMITS.acceleration)
    np.testing.assert_allclose(np.max(use, axis=0), 1.0, atol=1e-9)


def test_derivatives_agree_with_finite_differences() -> None:
    motion, t, h = _motion(), np.linspace(0.0, 12.0, 997), 1e-6
    np.testing.assert_allclose(
        (motion.position(t + h) - motion.position(t - h)) / (2 * h),
        motion.velocity(t),
        atol=1e-7,
    )
    np.testing.assert_allclose(
        (motion.velocity(t + h) - motion.velocity(t - h)) / (2 * h),
        motion.acceleration(t),
        atol=1e-6,
    )


def test_starts_and_ends_at_rest_in_the_centre() -> None:
    motion = _motion(centre=np.array([0.5, 0.1]))
    for t in (np.array([-1.0, 0.0]), np.array([12.0, 13.0])):
        np.testing.assert_allclose(motion.position(t), [[0.5, 0.1]] * 2, atol=1e-12)
        np.testing.assert_allclose(motion.velocity(t), 0, atol=1e-12)
        np.testing.assert_allclose(motion.acceleration(t), 0, atol=1e-9)


def test_same_seed_same_motion() -> None:
    np.testing.assert_array_equal(_motion(4).sine, _motion(4).sine)
    assert np.abs(_motion(4).sine - _motion(5).sine).max() > 0


def test_bad_requests_are_refused() -> None:
    with pytest.raises(InputError, match="joint 2"):
        _motion(centre=np.array([0.0, 1.0]))
    with pytest.raises(InputError, match="cannot rise"):
        _motion(duration=1.5)
