"""Motions made of motions: one after the other, and backwards."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gapscope.arm.motions.trajectory import ReferenceMotion


class Timed(ReferenceMotion, Protocol):
    """A reference motion that rests outside [0, duration]."""

    @property
    def duration(self) -> float:
        """Duration [s]."""


@dataclass(frozen=True)
class Chain:
    """Motions that follow each other, each beginning where the one before it rests.

    Attributes:
        parts: the motions.
    """

    parts: tuple[Timed, ...]

    @property
    def duration(self) -> float:
        """Sum of the parts' durations [s]."""
        return float(sum(part.duration for part in self.parts))

    def position(self, t: np.ndarray) -> np.ndarray:
        """Position [rad] at times t [s] of shape (N,); shape (N, n)."""
        return self._evaluate("position", t)

    def velocity(self, t: np.ndarray) -> np.ndarray:
        """Velocity [rad/s] at times t [s] of shape (N,); shape (N, n)."""
        return self._evaluate("velocity", t)

    def acceleration(self, t: np.ndarray) -> np.ndarray:
        """Acceleration [rad/s^2] at times t [s] of shape (N,); shape (N, n)."""
        return self._evaluate("acceleration", t)

    def _evaluate(self, quantity: str, t: np.ndarray) -> np.ndarray:
        t = np.asarray(t, dtype=float)
        durations = [part.duration for part in self.parts]
        ends = np.cumsum(durations)
        part_of = np.searchsorted(ends[:-1], t, side="right")
        n = self.parts[0].position(np.zeros(1)).shape[1]
        out = np.empty((len(t), n))
        for index in np.unique(part_of):
            rows = part_of == index
            begin = ends[index] - durations[index]
            evaluate = getattr(self.parts[index], quantity)
            out[rows] = evaluate(t[rows] - begin)
        return out


@dataclass(frozen=True)
class Reversed:
    """A motion run backwards: q(T - t).

    Attributes:
        forward: the motion.
    """

    forward: Timed

    @property
    def duration(self) -> float:
        """Duration T [s]."""
        return self.forward.duration

    def position(self, t: np.ndarray) -> np.ndarray:
        """Position [rad] at times t [s] of shape (N,); shape (N, n)."""
        return self.forward.position(self.duration - t)

    def velocity(self, t: np.ndarray) -> np.ndarray:
        """Velocity [rad/s] at times t [s] of shape (N,); shape (N, n)."""
        return -self.forward.velocity(self.duration - t)

    def acceleration(self, t: np.ndarray) -> np.ndarray:
        """Acceleration [rad/s^2] at times t [s] of shape (N,); shape (N, n)."""
        return self.forward.acceleration(self.duration - t)
