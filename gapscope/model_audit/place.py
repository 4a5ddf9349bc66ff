"""Place of one frame in another."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Place:
    """Place of a frame in another: p = R p' + x.

    Attributes:
        rotation: R [1], shape (3, 3).
        translation: x [m], shape (3,).
    """

    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    translation: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def __mul__(self, inner: Place) -> Place:
        """Place of a frame that is placed in this one."""
        shift = self.rotation @ inner.translation
        return Place(self.rotation @ inner.rotation, self.translation + shift)


def of_rpy(xyz: np.ndarray, rpy: np.ndarray) -> Place:
    """Place by position [m] and roll, pitch, yaw about fixed axes [rad], as a URDF has it."""
    return Place(Rotation.from_euler("xyz", rpy).as_matrix(), xyz)


def along(first: np.ndarray, second: np.ndarray) -> Place:
    """Place in the middle of two points [m] with the z axis from the first to the second."""
    direction = second - first
    length = np.linalg.norm(direction)
    z = direction / length if length else np.array([0.0, 0.0, 1.0])
    # any axis that is not along z will do for the others
    x = np.cross(z, np.eye(3)[np.abs(z).argmin()])
    x /= np.linalg.norm(x)
    return Place(np.column_stack([x, np.cross(z, x), z]), (first + second) / 2)
