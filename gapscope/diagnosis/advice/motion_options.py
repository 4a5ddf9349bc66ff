"""What the next recording may be: motions of several speeds, without and with a known payload."""

from __future__ import annotations

from dataclasses import dataclass, replace

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.known_load import KnownLoad
from gapscope.ident.excitation.excitation_plan import ExcitationPlan

SPEEDS = {
    "slow": ExcitationPlan(kind="fourier", order=5, frequency=0.05, duration=20.0),
    "moderate": ExcitationPlan(kind="fourier", order=5, frequency=0.1, duration=10.0),
    "quick": ExcitationPlan(kind="fourier", order=5, frequency=0.3, duration=10.0),
    "lively": ExcitationPlan(kind="multisine", order=10, frequency=0.5, duration=10.0),
}
"""Motions by the speed of their changes, up to 0.25, 0.5, 1.5 and 5 Hz."""


@dataclass(frozen=True)
class MotionOption:
    """One way to make the next recording.

    Attributes:
        speed: one of ``SPEEDS``.
        payload: known payload, or ``None``.
    """

    speed: str
    payload: KnownLoad | None

    @property
    def words(self) -> str:
        """In words."""
        top = highest(self.speed)
        load = (
            "without payload"
            if self.payload is None
            else f"with {self.payload.mass:g} kg"
        )
        return f"{self.speed} (up to {top:g} Hz), {load}"

    def plan(self, rate: float) -> ExcitationPlan:
        """The plan of its search, written at a rate [Hz]."""
        two = ("one explanation", "another")
        return replace(
            SPEEDS[self.speed], rate=rate, criterion="separation", effects=two
        )

    def body(self, nominal: RigidBody) -> RigidBody:
        """The arm's bodies with the payload."""
        return nominal.carrying(self.payload)


def highest(speed: str) -> float:
    """Frequency of the last harmonic of a speed [Hz]."""
    return SPEEDS[speed].order * SPEEDS[speed].frequency


def options(payload: KnownLoad | None, fastest: float) -> list[MotionOption]:
    """All options whose motions hold no frequency above ``fastest`` [Hz].

    Raises:
        InputError: there is none.
    """
    chosen = [name for name in SPEEDS if highest(name) <= fastest + 1e-9]
    if not chosen:
        least = min(highest(name) for name in SPEEDS)
        raise InputError(
            f"no motion is as slow as {fastest:g} Hz",
            f"give {least:g} Hz or more",
            where="fastest",
        )
    loads = [None] if payload is None else [None, payload]
    return [MotionOption(name, load) for name in chosen for load in loads]
