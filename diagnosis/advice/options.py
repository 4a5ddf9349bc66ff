"""What the next recording may be: motions of several speeds, without and with a known payload."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from arm.dynamics import RigidBody
from arm.errors import InputError
from effects.rigid_body import point_mass_parameters
from ident.excitation.plan import Plan

SPEEDS = {
    "slow": Plan(kind="fourier", order=5, frequency=0.05, duration=20.0),
    "moderate": Plan(kind="fourier", order=5, frequency=0.1, duration=10.0),
    "quick": Plan(kind="fourier", order=5, frequency=0.3, duration=10.0),
    "lively": Plan(kind="multisine", order=10, frequency=0.5, duration=10.0),
}
"""Motions by the speed of their changes, up to 0.25, 0.5, 1.5 and 5 Hz."""


@dataclass(frozen=True)
class KnownPayload:
    """A body that is screwed to the last link for the next recording.

    Attributes:
        mass: [kg].
        com: its centre in the frame of the joint that moves the last link [m], shape (3,).

    Raises:
        InputError: the mass is not above zero, or a number is not finite.
    """

    mass: float
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Check the numbers."""
        if not (np.isfinite(self.mass) and self.mass > 0):
            raise InputError(f"a payload of {self.mass:g} kg is none", "give its mass in kg", where="payload")
        if len(self.com) != 3 or not np.isfinite(self.com).all():
            raise InputError("the centre of the payload needs x, y and z", "give three numbers in m", where="payload")

    @property
    def words(self) -> str:
        """In words."""
        x, y, z = self.com
        return f"a payload of {self.mass:g} kg, centre at ({x:g}, {y:g}, {z:g}) m of the last joint's frame"


@dataclass(frozen=True)
class Option:
    """One way to make the next recording.

    Attributes:
        speed: one of ``SPEEDS``.
        payload: known payload, or ``None``.
    """

    speed: str
    payload: KnownPayload | None

    @property
    def words(self) -> str:
        """In words."""
        top = highest(self.speed)
        load = "without payload" if self.payload is None else f"with {self.payload.mass:g} kg"
        return f"{self.speed} (up to {top:g} Hz), {load}"

    def plan(self, rate: float) -> Plan:
        """The plan of its search, written at a rate [Hz]."""
        two = ("one explanation", "another")
        return replace(SPEEDS[self.speed], rate=rate, criterion="separation", effects=two)

    def body(self, nominal: RigidBody) -> RigidBody:
        """The arm's bodies with the payload."""
        if self.payload is None:
            return nominal
        added = np.zeros((len(nominal.inertial_parameters()) // 10, 10))
        added[nominal.last_link] = point_mass_parameters(self.payload.mass, np.array(self.payload.com))
        return nominal.changed(added)


def highest(speed: str) -> float:
    """Frequency of the last harmonic of a speed [Hz]."""
    return SPEEDS[speed].order * SPEEDS[speed].frequency


def options(payload: KnownPayload | None, fastest: float) -> list[Option]:
    """All options whose motions hold no frequency above ``fastest`` [Hz].

    Raises:
        InputError: there is none.
    """
    chosen = [name for name in SPEEDS if highest(name) <= fastest + 1e-9]
    if not chosen:
        least = min(highest(name) for name in SPEEDS)
        raise InputError(f"no motion is as slow as {fastest:g} Hz", f"give {least:g} Hz or more", where="fastest")
    loads = [None] if payload is None else [None, payload]
    return [Option(name, load) for name in chosen for load in loads]
