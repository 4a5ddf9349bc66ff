"""Dry friction as columns: the sign of motion, its memory at rest, and what it loses as the joint begins to move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.io.import_section import Import
from gapscope.arm.nominal import smooth_sign

STRIBECK_SPEEDS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
"""Speeds vs tried for d exp(-(v / vs)^2) [rad/s]."""
PRESLIDING_DISTANCES = (1e-4, 2e-4, 5e-4, 1e-3)
"""Distances tried over which dry friction turns round at a reversal [rad]."""


@dataclass(frozen=True)
class FrictionLaw:
    """Form of the dry friction of every drive: c s + d exp(-(v / vs)^2) s, s the direction of motion.

    Attributes:
        stribeck_speed: vs [rad/s]; ``None``: no such term.
        presliding: distance over which s turns from -1 to 1 [rad], so that it keeps its value at rest; ``None``: s is
            the smoothed sign of the velocity, as in the effects' catalogue.
    """

    stribeck_speed: float | None = None
    presliding: float | None = None

    @property
    def shapes(self) -> tuple[str, ...]:
        """Symbols of the columns per drive: c, and d if there is a Stribeck term."""
        return ("c",) if self.stribeck_speed is None else ("c", "d")

    def columns(self, position: np.ndarray, velocity: np.ndarray) -> list[np.ndarray]:
        """What c and d multiply [1], from position [rad] and velocity [rad/s] of shape (N, k); each (N, k)."""
        sign = (
            smooth_sign(velocity)
            if self.presliding is None
            else direction(position, velocity, self.presliding)
        )
        if self.stribeck_speed is None:
            return [sign]
        return [sign, sign * np.exp(-((velocity / self.stribeck_speed) ** 2))]

    def __str__(self) -> str:
        """In words, for the report."""
        parts = ["Coulomb and viscous"]
        if self.stribeck_speed is not None:
            parts.append(f"Stribeck below {self.stribeck_speed:g} rad/s")
        if self.presliding is not None:
            parts.append(
                f"direction kept at rest, turned round within {1e3 * self.presliding:g} mrad"
            )
        return ", ".join(parts)


def direction(
    position: np.ndarray, velocity: np.ndarray, distance: float
) -> np.ndarray:
    r"""State s of ds/dq = (1 - s sgn(dq)) / d, in [-1, 1], shape (N, k): Dahl's model with exponent 1.

    A joint that comes to rest keeps the direction that it had; s depends on the path alone, not on time.

    Args:
        position: q [rad], shape (N, k).
        velocity: dq [rad/s], shape (N, k); its first sign is the first direction.
        distance: d [rad].

    Source: dahl1976.
    """
    steps = np.diff(position, axis=0)
    signs = np.sign(steps)
    decay = np.exp(-np.abs(steps) / distance)
    state = smooth_sign(velocity[0])
    states = np.empty_like(position)
    states[0] = state
    for i in range(len(steps)):
        # the exact solution over a step of one direction
        state = signs[i] + (state - signs[i]) * decay[i]
        states[i + 1] = state
    return states


def drives(
    n_joints: int, importing: Import | None
) -> tuple[np.ndarray, tuple[str, ...]]:
    """What turns: D with speeds D dq [1], shape (n + k, n): the joints, then the k motors that move several of them.

    A motor's row of the transmission matrix is divided by the ratio to the joint of its own number, so that its speed
    and the friction along D^T count on that joint's side.

    Returns:
        D, and labels: ``1`` to ``n``, and ``6m`` for motor 6.
    """
    rows = [np.eye(n_joints)]
    labels = [str(j + 1) for j in range(n_joints)]
    if importing is None or importing.transmission is None:
        return rows[0], tuple(labels)
    # the matrix has the log's directions, the columns those of the URDF
    signs = np.ones(n_joints) if importing.signs is None else importing.signs
    for motor, row in enumerate(importing.transmission * signs):
        moves_several = np.count_nonzero(row) > 1
        if moves_several and row[motor] != 0:
            rows.append(row[None] / row[motor])
            labels.append(f"{motor + 1}m")
    return np.concatenate(rows), tuple(labels)
