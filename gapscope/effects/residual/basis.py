"""Fixed functions of a joint's signals, of which an additive model is a weighted sum."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from gapscope.effects.residual.inputs import Layout
from gapscope.effects.residual.memory import REACHES

WAVES = 64
"""Waves over the range of a joint; the finest has half a wavelength of 1/51 of the range."""
BEYOND = 1.25
"""Length on which the waves are periodic after two turns, over the range seen in training."""
BANDS = (0, 8, 24, WAVES)
"""Waves are weighted band by band."""
OWN, ALL = 48, 96
"""Random waves over the joint's own signals (at two lengths each), and over those of all joints."""
LENGTHS = (1.0, 3.0)
"""Lengths of the random waves, in standard deviations of the signals."""
FRICTION = 3
"""The direction that friction follows."""


@dataclass(frozen=True)
class Basis:
    """F functions for each of n joints, of its channels held within the range of training.

    Waves over its position, alone and times its direction; its directions and speed; its memory; its load, alone and
    times warmth, directions and speed; signals of the others; and random waves, of which sums are smooth functions of
    many variables (rahimi2007): of q, dq, ddq and load of the joint, and of q, dq and load of all.

    Attributes:
        low, high: range of the normalised channels in training, (n, C).
        own: wave vectors and phases over q, dq, ddq, load of the joint, (5, OWN).
        everything: the same over q, dq and load of all joints, (3 n + 1, ALL).
    """

    low: np.ndarray
    high: np.ndarray
    own: np.ndarray
    everything: np.ndarray

    @property
    def layout(self) -> Layout:
        """Places of the channels."""
        return Layout(len(self.low))

    def parts(self, now: np.ndarray) -> list[np.ndarray]:
        """The functions by kind, each (n, N, .), of normalised channels (n, N, C)."""
        x = np.clip(now, self.low[:, None], self.high[:, None])
        at, n = self.layout, self.layout.n
        direction, memory = x[..., at.direction], x[..., at.memory]
        speed, load, friction = x[..., :1], x[..., 2:3], direction[..., [FRICTION]]
        strain, warmth = memory[..., : len(REACHES)], memory[..., len(REACHES) :]
        others = x[..., at.others]
        position = x[..., at.angle : at.angle + n]
        own = np.concatenate([position[..., :1], x[..., :3]], axis=2)
        dq, _, loads, _ = np.split(others, 4, axis=2)
        everything = np.concatenate([position, speed, dq, load, loads], axis=2)
        waves = self._waves(x[..., at.angle])
        return [
            *waves,
            *(wave * friction for wave in waves),
            np.concatenate([direction, speed, speed * np.abs(speed)], axis=2),
            strain,
            np.concatenate([load, load**3], axis=2),
            load * warmth,
            friction * warmth,
            np.concatenate([np.abs(load) * direction, load * speed], axis=2),
            x[..., 1:2],
            others,
            *(_random_waves(own, self.own, length) for length in LENGTHS),
            _random_waves(everything, self.everything, np.sqrt(n) * 1.5),
        ]

    def features(self, now: np.ndarray) -> np.ndarray:
        """All functions, (n, N, F)."""
        return np.concatenate(self.parts(now), axis=2)

    def _waves(self, position: np.ndarray) -> list[np.ndarray]:
        """Cosines and sines of multiples of half a turn over ``BEYOND`` times the range, by band; (n, N, .)."""
        angle = self.layout.angle
        low, high = self.low[:, angle, None], self.high[:, angle, None]
        along = (position - low) / (BEYOND * np.maximum(high - low, 1e-9))
        phase = np.pi * along[:, :, None] * np.arange(1, WAVES + 1)
        cosine, sine = np.cos(phase), np.sin(phase)
        bands = [slice(a, b) for a, b in itertools.pairwise(BANDS)]
        return [np.concatenate([cosine[..., b], sine[..., b]], axis=2) for b in bands]


def _random_waves(x: np.ndarray, waves: np.ndarray, length: float) -> np.ndarray:
    """Cosines along random directions, (n, N, W), of x (n, N, D)."""
    return np.cos(x @ waves[:-1] / length + waves[-1])


def draw_basis(low: np.ndarray, high: np.ndarray, seed: int) -> Basis:
    """A basis on a range of normalised channels, (n, C), with its random waves drawn."""
    rng = np.random.default_rng(seed)

    def waves(inputs: int, count: int) -> np.ndarray:
        vectors = rng.standard_normal((inputs, count))
        return np.vstack([vectors, rng.uniform(0.0, 2 * np.pi, count)])

    return Basis(low, high, waves(4, OWN), waves(3 * len(low), ALL))


def part_of_each(basis: Basis) -> np.ndarray:
    """Number of the part that each function belongs to, (F,)."""
    n, channels = basis.low.shape
    sizes = [part.shape[2] for part in basis.parts(np.zeros((n, 1, channels)))]
    return np.repeat(np.arange(len(sizes)), sizes)
