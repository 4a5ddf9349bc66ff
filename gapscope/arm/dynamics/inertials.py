"""Boxes in place of collision shapes that are missing: of the same mass, centre and inertia as the bodies."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

THINNEST = 1e-3
"""Least edge of a box [m], for inertias whose largest moment is the sum of the others or above it."""


def box_edges(mass: float, moments: np.ndarray) -> np.ndarray:
    """Edges a_i [m] of the homogeneous box with principal moments I_i = m (a_j^2 + a_k^2) / 12, shape (3,).

    Solved for the edges: a_i^2 = 6 (I_j + I_k - I_i) / m.

    Args:
        mass: m [kg], above 0.
        moments: I about the centre of mass [kg m^2], shape (3,).
    """
    squares = 6 / mass * (moments.sum() - 2 * moments)
    return np.sqrt(np.maximum(squares, THINNEST**2))


def inertia_boxes(model: pin.Model) -> pin.GeometryModel:
    """One box for each body with mass, what is fixed to it included; the base is one if the file gives it mass."""
    shapes = pin.GeometryModel()
    for joint, inertia in enumerate(model.inertias):
        if inertia.mass <= 0:
            continue
        moments, axes = np.linalg.eigh(inertia.inertia)
        # eigenvectors may be those of a mirror; a box is the same either way
        axes[:, 2] *= np.linalg.det(axes)
        shapes.addGeometryObject(
            pin.GeometryObject(
                f"box of {model.names[joint]}",
                joint,
                pin.SE3(axes, inertia.lever),
                coal.Box(*box_edges(inertia.mass, moments)),
            )
        )
    return shapes
