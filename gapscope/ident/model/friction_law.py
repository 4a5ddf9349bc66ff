"""Friction of drives as columns: direction of motion, its memory at rest, Stribeck and saturating friction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.nominal import NominalArm
from gapscope.effects.friction import friction_direction

STRIBECK_SPEEDS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
"""Speeds vs tried for d exp(-(v / vs)^2) [rad/s]."""
SATURATION_SHARES = (0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.7)
"""Speeds vt tried for s tanh(|v| / vt), over the largest speed of each drive [1]."""
PRESLIDING_DISTANCES = (2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3)
"""Distances tried over which dry friction turns round at a reversal [rad]."""


@dataclass(frozen=True)
class FrictionLaw:
    r"""Friction of every drive beside b v: (c + d exp(-(v / vs)^2) + s tanh(\|v\| / vt)) e, e the direction of motion.

    Attributes:
        stribeck_speed: vs [rad/s]; ``None``: no such term.
        saturation_speeds: vt of each drive [rad/s]; ``None``: no such term.
        presliding: distance of each drive over which e turns from -1 to 1 [rad], so that it keeps its value at rest;
            0 or ``None``: e is the smoothed sign of the velocity, as in the effects' catalogue.
    """

    stribeck_speed: float | None = None
    saturation_speeds: tuple[float, ...] | None = None
    presliding: tuple[float, ...] | None = None

    @property
    def shapes(self) -> tuple[str, ...]:
        """Symbols of the columns per drive: c, d if there is a Stribeck term, s if there is one that saturates."""
        stribeck = () if self.stribeck_speed is None else ("d",)
        saturating = () if self.saturation_speeds is None else ("s",)
        return ("c", *stribeck, *saturating)

    def columns(self, position: np.ndarray, velocity: np.ndarray) -> list[np.ndarray]:
        """What c, d and s multiply [1], from position [rad] and velocity [rad/s] of shape (N, k); each (N, k)."""
        at_once = (0.0,) * velocity.shape[1]
        distance = np.array(self.presliding or at_once)
        sign = friction_direction(position, velocity, distance)
        columns = [sign]
        if self.stribeck_speed is not None:
            columns.append(sign * np.exp(-((velocity / self.stribeck_speed) ** 2)))
        if self.saturation_speeds is not None:
            relative = np.abs(velocity) / np.array(self.saturation_speeds)
            columns.append(sign * np.tanh(relative))
        return columns

    def __str__(self) -> str:
        """In words, for the report."""
        parts = ["Coulomb and viscous"]
        if self.stribeck_speed is not None:
            parts.append(f"Stribeck below {self.stribeck_speed:g} rad/s")
        if self.saturation_speeds is not None:
            speeds = ", ".join(f"{speed:.2g}" for speed in self.saturation_speeds)
            parts.append(f"saturating above {speeds} rad/s")
        if self.presliding is not None:
            distances = ", ".join(f"{1e3 * x:g}" for x in self.presliding)
            parts.append(
                f"direction kept at rest, turned round within {distances} mrad"
            )
        return ", ".join(parts)


def drives(arm: NominalArm) -> tuple[np.ndarray, tuple[str, ...]]:
    """What turns: D with speeds D dq [1], shape (n + k, n): the joints, then the k motors that move several of them.

    The speed of a motor, and the friction along D^T, count on the side of the joint of its own number.

    Returns:
        D, and labels: ``1`` to ``n``, and ``6m`` for motor 6.
    """
    joints = np.eye(arm.n_joints)
    labels = tuple(str(j + 1) for j in range(arm.n_joints))
    if arm.coupling is None or not arm.coupled_motors:
        return joints, labels
    rows = arm.coupling[[motor - 1 for motor in arm.coupled_motors]]
    motors = tuple(f"{motor}m" for motor in arm.coupled_motors)
    return np.vstack([joints, rows]), (*labels, *motors)
