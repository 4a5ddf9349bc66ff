"""The one check on numbers that no arm can have, whatever its unit: a description or data sheet is wrong there."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gapscope.arm.errors import InputError

LARGEST = {
    "length": (1e4, "m"),
    "mass": (1e6, "kg"),
    "moment of inertia": (1e9, "kg m^2"),
    "gravity": (1e3, "m/s^2"),
    "armature": (1e7, "kg m^2"),
    "friction": (1e7, "N m"),
    "viscous friction": (1e8, "N m s/rad"),
}
"""Largest size of a quantity, and its unit; of sliding joints the unit with m, N and kg.

The longest arms, on cranes and space stations, have 20 to 80 m; the heaviest industrial ones 12 t; dry friction and
holding torque reach some 1e5 N m. The bounds lie a hundred times above, so that what exceeds them is no unusual arm.
"""


def check_size(
    values: np.ndarray | float, quantity: str, file: Path | None, where: str
) -> None:
    """Check that no value of a quantity is beyond any arm's.

    Args:
        values: SI units, any shape.
        quantity: key of ``LARGEST``.
        file: that holds them.
        where: the place in it.

    Raises:
        InputError: one is.
    """
    largest, unit = LARGEST[quantity]
    sizes = np.abs(np.atleast_1d(np.asarray(values, dtype=float)))
    if sizes.size and sizes.max() > largest:
        raise InputError(
            f"a {quantity} of {sizes.max():.3g} {unit} is beyond any arm's ({largest:g} {unit})",
            "correct it; SI units are expected: kg, m, s, rad, N m",
            file=file,
            where=where,
        )
