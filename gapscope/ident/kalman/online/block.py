"""What a block of samples says of p parameters, in a size that does not depend on its length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

LEAST_NOISE = 1e-3
"""Least noise over the RMS of a joint's torque [1]: none at all would make every deviation count."""


@dataclass(frozen=True)
class Equations:
    """r = W delta + noise: torque that a model leaves, and what small changes of p parameters would add to it.

    Attributes:
        matrix: W, shape (N, n, p); zero in the rows of a joint that rests.
        gap: r [N m], shape (N, n); zero in these rows.
        moving: which joints count at each sample, shape (N, n).
        torque: recorded, in the band [N m], shape (N, n).
        velocity: dq [rad/s], shape (N, n).
    """

    matrix: np.ndarray
    gap: np.ndarray
    moving: np.ndarray
    torque: np.ndarray
    velocity: np.ndarray

    def normal(self, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A = sum W^T W / sigma^2, shape (p, p), and s = sum W^T r / sigma^2, (p,), with sigma [N m] of shape (n,)."""
        W = (self.matrix / noise[:, None]).reshape(-1, self.matrix.shape[2])
        r = (self.gap / noise).ravel()
        return W.T @ W, W.T @ r

    def residual(self, delta: np.ndarray) -> np.ndarray:
        """The gap less W delta [N m], shape (N, n)."""
        return np.asarray(self.gap - self.matrix @ delta)

    def rms(self, series: np.ndarray) -> np.ndarray:
        """RMS of a series (N, n) over the samples at which each joint moves, (n,); 0 of one that rests throughout."""
        count = np.maximum(self.moving.sum(axis=0), 1)
        return np.sqrt((series**2 * self.moving).sum(axis=0) / count)

    def own_noise(self, noise: np.ndarray, prior: np.ndarray) -> np.ndarray:
        """RMS that no plausible change of the parameters explains [N m], shape (n,).

        The residual of ridge regression, delta = (A + P0^-1)^-1 s; the equations that the fit used up are counted off.

        Args:
            noise: sigma by which joints are weighed against each other [N m], (n,).
            prior: standard deviations of plausible changes, the root of the diagonal of P0, (p,).
        """
        A, s = self.normal(noise)
        scaled = A * prior[:, None] * prior
        inverse = np.linalg.inv(scaled + np.eye(len(prior)))
        fitted = float(np.trace(scaled @ inverse))
        delta = prior * (inverse @ (prior * s))
        left = 1.0 - fitted / max(float(self.moving.sum()), fitted + 1.0)
        return self.rms(self.residual(delta)) / np.sqrt(max(left, 0.1))


@dataclass(frozen=True)
class Block:
    """A block reduced to what it says of the parameters.

    Attributes:
        recording: its name.
        start, end: time of its first and last sample [s].
        duration: that it counts for [s].
        information: A, shape (p, p).
        score: s, shape (p,).
    """

    recording: str
    start: float
    end: float
    duration: float
    information: np.ndarray
    score: np.ndarray


def summed(blocks: Sequence[Block], count: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Sums over some blocks: A (p, p), s (p,), and their duration [s]; zeros of none, with p = ``count``."""
    A, s, duration = np.zeros((count, count)), np.zeros(count), 0.0
    for block in blocks:
        A += block.information
        s += block.score
        duration += block.duration
    return A, s, duration
