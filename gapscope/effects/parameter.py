"""A parameter of an effect or of a setup fault: its name, unit and range."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect.

    Attributes:
        name: the key in ``diagnosis.json`` and ``corrected.yaml``.
        symbol: symbol in equations.
        unit: SI unit, joint side.
        bounds: physically possible range.
        typical: range of severities met on real arms, for drawing at random and for plausibility checks.
        size: 1 for a scalar, 3 for a vector.
        increment: whether the value adds to the nominal arm's (friction, armature, mass) or is the value itself.
        severity: how the value goes with the severity of its effect: 1 in proportion, -1 the smaller the more severe (a
            limit, a stiffness), 0 not at all, since it says where or when. An effect is off if all others are 0.
        absent: value of a parameter that need not be given; ``None`` if it has to be.
    """

    name: str
    symbol: str
    unit: str
    bounds: tuple[float, float]
    typical: tuple[float, float]
    size: int = 1
    increment: bool = False
    severity: Literal[-1, 0, 1] = 1
    absent: float | None = None
