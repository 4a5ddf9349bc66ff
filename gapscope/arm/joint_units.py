"""Units of joints that slide: metres, newtons and kilograms in place of radians, newton metres and kg m^2."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

METRES_PER_RADIAN = 0.1
"""What of a slide counts as one radian of a joint that turns [m]: the radius of a usual pinion. By it, speeds and
distances that are set in radians (where dry friction changes sign, how far a tooth bends, when a joint moves) apply to
slides."""

SLIDING_UNITS = {
    "rad": "m",
    "rad/s": "m/s",
    "rad/s^2": "m/s^2",
    "rad/s²": "m/s²",
    "rad/s^3": "m/s^3",
    "N m": "N",
    "N m/s": "N/s",
    "N m/rad": "N/m",
    "N m s/rad": "N s/m",
    "N m s²/rad": "N s²/m",
    "N m per N m": "N per N",
    "kg m^2": "kg",
}
"""Unit of a quantity of a joint that slides, by its unit of a joint that turns."""


def per_radian(sliding: Sequence[bool]) -> np.ndarray:
    """What counts as one radian of each joint [rad or m], shape (n,)."""
    return np.where(np.array(sliding, dtype=bool), METRES_PER_RADIAN, 1.0)


def size_per_radian(unit: str, sliding: Sequence[bool]) -> np.ndarray:
    """Factor from a usual size on joints that turn to that on each joint [1], shape (n,), for a quantity of a unit.

    A force is a torque over ``METRES_PER_RADIAN``, a distance an angle times it; masses and stiffnesses follow.
    """
    # powers of the radian: torque is energy over angle, inertia over its square
    powers = {
        "rad": 1,
        "rad/s": 1,
        "N m": -1,
        "N m/rad": -2,
        "N m s/rad": -2,
        "kg m^2": -2,
    }
    return per_radian(sliding) ** powers.get(unit, 0)


def joint_unit(unit: str, slides: bool) -> str:
    """Unit of a joint's quantity, from that of a joint that turns; a unit without an angle stays."""
    return SLIDING_UNITS.get(unit, unit) if slides else unit


def units_of(unit: str, sliding: Sequence[bool]) -> list[str]:
    """Unit of a quantity of each joint."""
    return [joint_unit(unit, slides) for slides in sliding]


def common_unit(unit: str, sliding: Sequence[bool]) -> str:
    """The unit of some joints' quantity in one text: ``N m``, ``N``, or ``N m or N`` if both kinds are among them."""
    return " or ".join(dict.fromkeys(units_of(unit, sorted(sliding)))) or unit
