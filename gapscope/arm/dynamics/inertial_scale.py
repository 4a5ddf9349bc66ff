"""The size of an arm's inertial parameters, against which their errors are measured, and how these go together."""

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


# How the inertial parameters of a nominal arm are wrong together: each body's mass, centre and shape.
#
# A body whose mass is wrong by a share u has first and second moments that are wrong by the same share, as a part that
# was left out or a wrong density does. Its centre is off by a distance, and its moments of inertia about the centre
# differ from those of the mass by less. Errors of the ten parameters of one body are therefore far from independent.


SHAPE_ERROR = 0.3
"""Error of the shape of a body's inertia about its centre, over the error of its mass [1]. (hand)"""
MOMENTS = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
"""Places in the matrix of inertia of the last six parameters of a body."""


def inertial_errors(parameters: np.ndarray, units: np.ndarray) -> np.ndarray:
    """Root R of the covariance R R^T of the inertial errors, (10 n, 10 n), if masses are off by their own size.

    Per body, with mass m, centre c, D = max(|c|, 5 cm) (that of the units) and inertia I_c about the centre:
    u (m, h, I); a shift of the centre by D in all, D / sqrt 3 along each axis; and each moment of I_c by
    ``SHAPE_ERROR`` tr(I_c) / 2, products by half of that. A body without mass has no error.

    Args:
        parameters: inertial parameters about the joints' frames, (10 n,) [kg, kg m, kg m^2].
        units: size of each, in which R counts, (10 n,); see ``gapscope.arm.dynamics.inertial_scale``.
    """
    bodies = parameters.reshape(-1, 10)
    sizes = units.reshape(-1, 10)
    root = np.zeros((len(bodies), 10, len(bodies), 10))
    for k, (body, size) in enumerate(zip(bodies, sizes, strict=True)):
        if body[0] > 0:
            own = _of_body(body, size[1] / body[0])
            # a point on the joint's axis has no moments of inertia, and no error of them
            known = size > 0
            root[k, known, k] = own[known] / size[known, None]
    return root.reshape(len(parameters), len(parameters))


def _of_body(body: np.ndarray, distance: float) -> np.ndarray:
    """Columns of one body's errors: its mass, three of its centre, six of its shape, (10, 10)."""
    mass, centre = body[0], body[1:4] / body[0]
    about_joint = np.zeros((3, 3))
    for value, (i, j) in zip(body[4:], MOMENTS, strict=True):
        about_joint[i, j] = about_joint[j, i] = value
    about_centre = about_joint - mass * _spread(centre, centre)
    out = np.zeros((10, 10))
    out[:, 0] = body
    for axis, shift in enumerate(distance / np.sqrt(3.0) * np.eye(3)):
        # m (c^T c E - c c^T) changes with the centre by twice its symmetric part
        change = 2.0 * mass * _spread(centre, shift)
        out[1:4, 1 + axis] = mass * shift
        out[4:, 1 + axis] = [change[i, j] for i, j in MOMENTS]
    shape = SHAPE_ERROR * max(0.5 * float(np.trace(about_centre)), 0.0)
    for place, (i, j) in enumerate(MOMENTS):
        out[4 + place, 4 + place] = shape if i == j else 0.5 * shape
    return out


def _spread(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a^T b E - (a b^T + b a^T) / 2, the second moments of unit mass at a if b = a, (3, 3)."""
    return np.asarray(a @ b * np.eye(3) - 0.5 * (np.outer(a, b) + np.outer(b, a)))
