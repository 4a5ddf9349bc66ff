"""What the controllers of many arms have: readings of the encoders, and the velocity estimated from them."""

from __future__ import annotations

import numpy as np

from gapscope.arm.velocity_filter import VelocityFilter, filter_gains
from gapscope.envs.drive.arm_drive import Encoders
from gapscope.envs.position_controller import VELOCITY_DAMPING, cutoff


class Readings:
    """The encoders of N rigid arms, n joints in the arm's order; each arm has its own source of noise.

    Args:
        one: those of one arm.
        noise: standard deviation [rad], a number or shape (n,).
        shape: (N, n).
    """

    def __init__(
        self, one: Encoders, noise: np.ndarray | float, shape: tuple[int, int]
    ) -> None:
        count, n = shape
        self._one, self._all = [one] * count, one.beside(count)
        self._noise, self._noisy = np.broadcast_to(noise, n), bool(np.any(noise))
        self._rngs = [np.random.default_rng() for _ in range(count)]

    def put(self, number: int, one: Encoders, seed: np.ndarray) -> None:
        """Give an arm, numbered from 0, other encoders, and its noise a seed, whole numbers of shape (k,)."""
        self._one[number] = one
        self._all.put(number, one)
        self._rngs[number] = np.random.default_rng(seed)

    def __call__(self, q: np.ndarray) -> np.ndarray:
        """Readings [rad] of the true positions q [rad], shape (N, n)."""
        noise = None
        if self._noisy:
            noise = np.concatenate([self._drawn(number) for number in range(len(q))])
        return self._all(q.ravel(), noise).reshape(q.shape)

    def of(self, number: int, q: np.ndarray) -> np.ndarray:
        """Reading [rad] of one arm at its true position q [rad], shape (n,)."""
        return self._one[number](q, self._drawn(number) if self._noisy else None)

    def _drawn(self, number: int) -> np.ndarray:
        """Noise of an arm [rad], shape (n,)."""
        rng = self._rngs[number]
        return self._noise * rng.standard_normal(len(self._noise))


class VelocityFilters:
    """``VelocityFilter`` of N arms, n joints.

    Args:
        rate: sampling rate [Hz].
        shape: (N, n).
    """

    def __init__(self, rate: float, shape: tuple[int, int]) -> None:
        self._rate = rate
        self._gains = np.array(filter_gains(rate, cutoff(rate), VELOCITY_DAMPING))
        self._past = np.zeros((shape[0], 5, shape[1]))

    def put(self, number: int, position: np.ndarray, velocity: np.ndarray) -> None:
        """Start an arm at a position [rad], until which it had a velocity [rad/s], each (n,)."""
        rate = self._rate
        one = VelocityFilter(rate, cutoff(rate), VELOCITY_DAMPING, position, velocity)
        self._past[number] = one.past

    def __call__(self, q: np.ndarray) -> np.ndarray:
        """Filtered velocities [rad/s] for the next positions q [rad], shape (N, n); valid until the next call."""
        past = self._past
        past[:, 0] = q
        # one product per arm: a single large one would round differently
        v = np.matmul(self._gains, past)
        past[:, 2] = past[:, 1]
        past[:, 1] = q
        past[:, 4] = past[:, 3]
        past[:, 3] = v
        return v
