"""What a passive arm cannot have: friction or rotors below zero in total, bodies with negative kinetic energy.

An arm is passive if over any motion it gives back no more energy than it was given: friction power dq tau_f >= 0 and
dq^T M(q) dq >= 0. Springs may be negative: their energy depends on the position alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from gapscope.arm.dynamics.plain_urdf import check_inertia
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.effects.applied import AppliedEffect

ROUNDING = 1e-8
"""Values this far below zero are rounding, and count as zero [N m, N m s/rad, kg m^2]."""
NOT_NEGATIVE = {
    f"{of}{quantity}": unit
    for of in ("", "motor_")
    for quantity, unit in (
        ("friction", "N m"),
        ("damping", "N m s/rad"),
        ("rotor", "kg m^2"),
    )
}
"""Quantities of drives that feed energy in below zero, with their units."""


def total(values: np.ndarray, name: str, unit: str) -> np.ndarray:
    """Values per joint that may not be negative, since that would feed energy in, shape (n,); rounding is taken off.

    Raises:
        InputError: one is negative.
    """
    if (values < -ROUNDING).any():
        joint = int(values.argmin())
        raise InputError(
            f"nominal value plus effect is {values[joint]:.4g} {unit} at joint {joint + 1}, which would feed energy in",
            "give an increment that leaves the total at zero or above",
            where=name,
        )
    return np.maximum(values, 0.0)


def check_totals(
    effects: Iterable[AppliedEffect], quantity: Callable[[str], np.ndarray]
) -> None:
    """Check that friction and rotors with their effects are not negative in total.

    Args:
        effects: that act on the arm; quantities of no effect are not looked at.
        quantity: value over all joints, (n,), as ``CorrectedArm.quantity``.

    Raises:
        InputError: one is negative; names effect and joint.
    """
    for applied in effects:
        for named in applied.effect.quantities.values():
            if named in NOT_NEGATIVE:
                total(quantity(named), applied.name, NOT_NEGATIVE[named])


def is_movable(body: RigidBody) -> bool:
    """Whether bodies have positive kinetic energy in every posture that is looked at, as real ones have."""
    try:
        check_inertia(body)
    except InputError:
        return False
    return True
