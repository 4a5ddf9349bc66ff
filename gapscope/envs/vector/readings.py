"""What the controllers of many arms have: readings of the encoders, and the velocity estimated from them."""

from __future__ import annotations

import numpy as np

from gapscope.arm.velocity_filter import VelocityFilter, filter_gains
from gapscope.effects.sensing import quantize
from gapscope.envs.drive.encoders import Encoders
from gapscope.envs.velocity_estimate import VELOCITY_DAMPING, cutoff


class Readings:
    """The encoders of N rigid arms, n joints in the arm's order; each arm has its own source of noise.

    Args:
        one: those of one arm, without noise.
        noise: standard deviation [rad], a number or shape (n,).
        count: N.
    """

    def __init__(self, one: Encoders, noise: np.ndarray | float, count: int) -> None:
        self._one = [one] * count
        self._noise = np.broadcast_to(noise, one.offset.shape)
        self._rngs = [np.random.default_rng() for _ in range(count)]
        self._offset, self._step = (
            np.tile(values, (count, 1)) for values in (one.offset, one.step)
        )
        self._noisy = bool(self._noise.any())
        self._note()

    def _note(self) -> None:
        self._exact, self._rounded = not self._step.any(), bool((self._step > 0).all())

    def put(self, number: int, one: Encoders, seed: np.ndarray) -> None:
        """Give an arm, numbered from 0, other encoders, and its noise a seed, whole numbers of shape (k,)."""
        self._offset[number], self._step[number] = one.offset, one.step
        self._rngs[number] = np.random.default_rng(seed)
        self._note()

    def __call__(self, q: np.ndarray) -> np.ndarray:
        """Readings [rad] of the true positions q [rad], shape (N, n)."""
        return self._read(q, self._offset, self._step, self._rngs)

    def of(self, number: int, q: np.ndarray) -> np.ndarray:
        """Reading [rad] of one arm at its true position q [rad], shape (n,)."""
        part = slice(number, number + 1)
        return self._read(
            q[None], self._offset[part], self._step[part], self._rngs[part]
        )[0]

    def _read(
        self,
        q: np.ndarray,
        offset: np.ndarray,
        step: np.ndarray,
        rngs: list[np.random.Generator],
    ) -> np.ndarray:
        seen = q + offset
        if self._noisy:
            for row, rng in zip(seen, rngs, strict=True):
                row += self._noise * rng.standard_normal(len(row))
        if self._exact:
            return seen
        if self._rounded:  # as ``quantize``, but without a look at each step
            np.divide(seen, step, seen)
            np.rint(seen, seen)
            return np.multiply(seen, step, seen)
        return quantize(seen, step)


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
