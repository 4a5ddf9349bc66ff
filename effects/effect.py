"""What an effect is: a frozen record, and the four ways in which an effect can act."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

Law = Callable[..., np.ndarray]


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect.

    Attributes:
        name: the key in ``diagnosis.json`` and ``corrected.yaml``.
        symbol: symbol in equations.
        unit: SI unit, joint side.
        bounds: physically possible range.
        typical: range of severities met on real arms, for drawing at random and for judging plausibility.
        size: 1 for a scalar, 3 for a vector.
        increment: whether the value adds to the nominal arm's (friction, armature, mass) or stands for itself.
    """

    name: str
    symbol: str
    unit: str
    bounds: tuple[float, float]
    typical: tuple[float, float]
    size: int = 1
    increment: bool = False


@dataclass(frozen=True)
class Effect:
    """One named physical cause of a gap.

    Attributes:
        name: name in the catalogue.
        family: friction, rigid_body, transmission, actuation, sensing or environment.
        scope: ``joint``, ``link`` or ``arm``.
        equation: how it acts, as text for the report.
        parameters: its parameters.
        looks_like: what gives it away in data.
        reference: source of the form or of the typical values; a key of ``docs/references.md``.
        confused_with: names of effects that look alike, each with the recording that separates the two.
    """

    name: str
    family: str
    scope: str
    equation: str
    parameters: tuple[Parameter, ...]
    looks_like: str
    reference: str
    confused_with: tuple[tuple[str, str], ...] = ()

    def parameter(self, name: str) -> Parameter:
        """The parameter called ``name``; raises ``KeyError`` if there is none."""
        if name not in self.names:
            raise KeyError(f"{self.name} has no parameter {name!r}; it has {', '.join(self.names)}")
        return next(p for p in self.parameters if p.name == name)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.parameters)


@dataclass(frozen=True)
class TorqueLaw(Effect):
    """A torque that opposes the motor: recorded = nominal + law(velocity, load, parameters).

    ``law(velocity, load, value)`` is a pure function that broadcasts: velocity [rad/s], load [N m] (the nominal
    torque through the transmission), value the parameter per joint; returns N m.
    """

    law: Law = field(kw_only=True)


@dataclass(frozen=True)
class Inertial(Effect):
    """A change of the model's inertia: it adds to the torque that the rigid body needs."""


@dataclass(frozen=True)
class Path(Effect):
    """Something between the recorded torque and the joint.

    ``inverse(needed, value, shift)`` gives the torque that must be recorded so that ``needed`` [N m] reaches the
    joint; ``shift(x, T)`` evaluates the series x at t + T [s], T per joint.
    """

    inverse: Law = field(kw_only=True)


@dataclass(frozen=True)
class Sensing(Effect):
    """A map between true and recorded position; ``true(recorded, value)`` undoes it [rad]."""

    true: Law = field(kw_only=True)
