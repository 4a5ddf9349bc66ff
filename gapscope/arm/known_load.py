"""A known body mounted on the last link while a recording was made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.nominal import check_size

UPPER = ([0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2])
"""Rows and columns of Ixx, Ixy, Iyy, Ixz, Iyz, Izz, the order of ``rigid_body.INERTIAL_PARAMETERS``."""


def point_mass_parameters(mass: float, com: np.ndarray) -> np.ndarray:
    """Ten inertial parameters of a point mass, in the frame of ``com``; shape (10,).

    m [kg], m c [kg m], and I = m (c.c E - c c^T) [kg m^2] in the order of
    ``gapscope.arm.dynamics.rigid_body.INERTIAL_PARAMETERS``.
    """
    c = np.asarray(com, dtype=float)
    inertia = mass * (c @ c * np.eye(3) - np.outer(c, c))
    return np.concatenate([[mass], mass * c, inertia[UPPER]])


@dataclass(frozen=True)
class KnownLoad:
    """A point mass on the last link whose mass and place are known.

    Attributes:
        mass: [kg].
        com: its centre in the frame of the joint that moves the last link [m], shape (3,).

    Raises:
        InputError: the mass is negative, or a number is not finite.
    """

    mass: float
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Check the numbers."""
        # so written that nan fails as well
        if not (np.isfinite(self.mass) and self.mass >= 0):
            raise InputError(
                f"a payload of {self.mass:g} kg is none",
                "give its mass in kg",
                where="mass",
            )
        check_size(self.mass, "mass", None, "mass")
        if np.shape(self.com) != (3,) or not np.isfinite(self.com).all():
            raise InputError(
                "the centre of the payload needs x, y and z",
                "give three numbers in m",
                where="com",
            )
        check_size(np.array(self.com), "length", None, "com")

    @property
    def parameters(self) -> np.ndarray:
        """What it adds to the inertial parameters of the last link, shape (10,); kg, kg m, kg m^2."""
        return point_mass_parameters(self.mass, np.array(self.com))

    @property
    def words(self) -> str:
        """In words."""
        x, y, z = self.com
        return f"a payload of {self.mass:g} kg, centre at ({x:g}, {y:g}, {z:g}) m of the last joint's frame"

    def entry(self) -> dict[str, Any]:
        """Its entry in the ``payloads:`` section of a case."""
        return {"mass": self.mass, "com": list(self.com)}
