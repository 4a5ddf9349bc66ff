"""The size of an arm's inertial parameters, against which their errors are measured."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody

MIN_LEVER = 0.05
"""Least distance at which the mass counts for the first moments [m]: a centre on the axis may be off as well."""


def inertial_scale(body: RigidBody) -> np.ndarray:
    """Change of each inertial parameter if it is off by its own size, shape (10 n,), in kg, kg m, kg m^2.

    Mass m; first moments m max(|c|, 5 cm); all six moments of inertia tr(I) / 2, about the joint's frame.
    """
    parameters = body.inertial_parameters().reshape(-1, 10)
    mass, hx, hy, hz, ixx, _, iyy, _, _, izz = parameters.T
    moment = np.maximum(np.hypot(np.hypot(hx, hy), hz), MIN_LEVER * mass)
    inertia = 0.5 * (ixx + iyy + izz)
    per_link = np.column_stack([mass, moment, inertia])
    return np.repeat(per_link, [1, 3, 6], axis=1).ravel()
