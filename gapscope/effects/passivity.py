"""What a passive arm cannot have: friction or rotors below zero in total, bodies with negative kinetic energy.

An arm is passive if over any motion it gives back no more energy than it was given: friction power dq tau_f >= 0 and
dq^T M(q) dq >= 0. Springs may be negative: their energy depends on the position alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.effects.coupled_motors import (
    COUPLED_ARMATURE,
    COUPLED_COULOMB,
    COUPLED_VISCOUS,
)
from gapscope.effects.friction import COULOMB, VISCOUS
from gapscope.effects.rigid_body import ARMATURE

ROUNDING = 1e-8
"""Values this far below zero are rounding, and count as zero [N m, N m s/rad, kg m^2]."""
TOTALS = (
    ("coulomb", COULOMB.name, "torque", "N m"),
    ("viscous", VISCOUS.name, "coefficient", "N m s/rad"),
    ("armature", ARMATURE.name, "inertia", "kg m^2"),
    ("", COUPLED_COULOMB.name, "torque", "N m"),
    ("", COUPLED_VISCOUS.name, "coefficient", "N m s/rad"),
    ("", COUPLED_ARMATURE.name, "inertia", "kg m^2"),
)
"""Value of the data sheet, if there is one, and the effect and parameter that add to it, with their unit."""


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
    arm: NominalArm, names: Sequence[str], value: Callable[[str, str], np.ndarray]
) -> None:
    """Check that friction and rotors with their effects are not negative in total.

    Args:
        arm: the nominal arm.
        names: of the effects that act on it; others are not looked at.
        value: of an effect's parameter over all joints, (n,), as ``CorrectedArm.value``.

    Raises:
        InputError: one is negative; names effect and joint.
    """
    for stated, name, parameter, unit in TOTALS:
        if name in names:
            nominal = getattr(arm, stated) if stated else 0.0
            total(nominal + value(name, parameter), name, unit)
