"""Inertials of bodies: boxes in their place, what is odd about them, as elements of a URDF, pseudo-inertias."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import coal
import numpy as np
import pinocchio as pin

from gapscope.arm.display import figures
from gapscope.arm.dynamics.description import MOMENTS, Inertial
from gapscope.arm.dynamics.plain_urdf import numbers
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.known_load import UPPER


def box_edges(mass: float, moments: np.ndarray) -> np.ndarray:
    """Edges a_i [m] of the homogeneous box with principal moments I_i = m (a_j^2 + a_k^2) / 12, shape (3,).

    Solved for the edges: a_i^2 = 6 (I_j + I_k - I_i) / m; 0 if the largest moment is above the sum of the others.

    Args:
        mass: m [kg], above 0.
        moments: I about the centre of mass [kg m^2], shape (3,).
    """
    return np.sqrt(np.maximum(6 / mass * (moments.sum() - 2 * moments), 0.0))


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


# Moving bodies whose inertials no real body has; they are simulated as they are, with a warning.


TRIANGLE_EXCESS = 2e-3
"""Share by which the largest moment may exceed the sum of the others, for numbers of four digits [1]. (physical)"""


def odd_inertials(body: RigidBody) -> tuple[str, ...]:
    """What is odd about the moving bodies of an arm, merged with what is fixed to them; a sentence each."""
    notes = []
    for joint, (name, link) in enumerate(zip(body.joints, body.links, strict=True), 1):
        inertia = body.model.inertias[int(link)]
        moments = np.linalg.eigvalsh(inertia.inertia)
        if inertia.mass == 0 and not moments.any():
            said = (
                "no <inertial>: it is simulated without mass; give it one if it has any"
            )
        elif inertia.mass == 0:
            said = "moments of inertia but no mass, which no body has; correct <mass>"
        elif moments[2] > (1 + TRIANGLE_EXCESS) * (moments[0] + moments[1]):
            said = (
                f"the principal moments of inertia {figures(moments)} kg m^2, of which no body has one above the "
                "sum of the others: they are simulated as they are; correct <inertia> if you can"
            )
        else:
            continue
        notes.append(
            f"{body.file}: the link moved by joint {joint} ({name}) has {said}"
        )
    return tuple(notes)


# Inertial parameters of the links of a URDF, as they are read and written into its elements.


def own_parameters(inertial: Inertial | None) -> np.ndarray:
    """The ten parameters of a link alone, without what is fixed to it, in its own frame; zero without an inertial.

    In the order of ``gapscope.arm.dynamics.rigid_body.INERTIAL_PARAMETERS``; kg, kg m, kg m^2; shape (10,).
    """
    if inertial is None:
        return np.zeros(10)
    body = pin.Inertia(inertial.mass, inertial.com, inertial.moments)
    return np.asarray(body.toDynamicParameters())


def set_parameters(link: ET.Element, parameters: np.ndarray) -> None:
    """Give a link these ten parameters, in its own frame."""
    # the file's own origin and axes go: all is said in the link's frame
    for old in link.findall("inertial"):
        link.remove(old)
    if np.any(parameters):
        body = pin.Inertia.FromDynamicParameters(np.asarray(parameters, dtype=float))
        link.insert(0, inertial_element(body.mass, body.lever, body.inertia))


def inertial_element(mass: float, com: np.ndarray, moments: np.ndarray) -> ET.Element:
    """An ``<inertial>`` in its link's frame: mass [kg], centre [m], (3,), and moments about it [kg m^2], (3, 3)."""
    inertial = ET.Element("inertial")
    ET.SubElement(inertial, "origin", rpy="0 0 0", xyz=numbers(com))
    ET.SubElement(inertial, "mass", value=repr(float(mass)))
    # a symmetric matrix: its six numbers, in URDF's order
    six = map(repr, moments[np.triu_indices(3)].tolist())
    ET.SubElement(inertial, "inertia", dict(zip(MOMENTS, six, strict=True)))
    return inertial


def possible(parameters: np.ndarray) -> bool:
    """Whether a body can have these ten parameters: mass above zero, moments not below it and within the triangle."""
    if parameters[0] <= 0:
        return False
    inertia = pin.Inertia.FromDynamicParameters(np.asarray(parameters, dtype=float))
    least, middle, largest = np.linalg.eigvalsh(inertia.inertia)
    # rounding of a body at the very edge of what is possible
    slack = 1e-9 * largest
    return bool(least >= -slack and largest <= least + middle + slack)


# The size of an arm's inertial parameters, against which their errors are measured, and how these go together.


MIN_LEVER = 0.05
"""Least distance at which the mass counts for the first moments [m]: a centre on the axis may be off as well."""


def inertial_scale(body: RigidBody) -> np.ndarray:
    """Change of each inertial parameter if it is off by its own size, shape (10 n,), in kg, kg m, kg m^2.

    Mass m; first moments m max(|c|, 5 cm); all six moments of inertia tr(I) / 2, about the joint's frame.
    """
    parameters = body.inertial_parameters().reshape(-1, 10)
    mass, hx, hy, hz, ixx, _, iyy, _, _, izz = parameters.T
    moment = np.maximum(np.hypot(np.hypot(hx, hy), hz), MIN_LEVER * mass)
    # about the joint, so that a centre far out makes large moments
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


def inertial_errors(parameters: np.ndarray, units: np.ndarray) -> np.ndarray:
    """Root R of the covariance R R^T of the inertial errors, (10 n, 10 n), if masses are off by their own size.

    Per body, with mass m, centre c, D = max(|c|, 5 cm) (that of the units) and inertia I_c about the centre:
    u (m, h, I); a shift of the centre by D in all, D / sqrt 3 along each axis; and each moment of I_c by
    ``SHAPE_ERROR`` tr(I_c) / 2, products by half of that. A body without mass has no error.

    Args:
        parameters: inertial parameters about the joints' frames, (10 n,) [kg, kg m, kg m^2].
        units: size of each, in which R counts, (10 n,); see ``gapscope.arm.dynamics.inertials``.
    """
    bodies = parameters.reshape(-1, 10)
    sizes = units.reshape(-1, 10)
    root = np.zeros((len(bodies), 10, len(bodies), 10))
    for k, (body, size) in enumerate(zip(bodies, sizes, strict=True)):
        if body[0] > 0:
            # the distance that counts for the first moments: size over mass
            own = _of_body(body, size[1] / body[0])
            # a point on the joint's axis has no moments of inertia, and no error of them
            known = size > 0
            root[k, known, k] = own[known] / size[known, None]
    return root.reshape(len(parameters), len(parameters))


def _of_body(body: np.ndarray, distance: float) -> np.ndarray:
    """Columns of one body's errors: its mass, three of its centre, six of its shape, (10, 10)."""
    about_centre = pin.Inertia.FromDynamicParameters(body)
    mass, centre = about_centre.mass, about_centre.lever
    out = np.zeros((10, 10))
    # mass wrong by a share: all ten parameters are wrong by it
    out[:, 0] = body
    for axis, shift in enumerate(distance / np.sqrt(3.0) * np.eye(3)):
        # m (c^T c E - c c^T) changes with the centre by twice its symmetric part
        change = 2.0 * mass * _spread(centre, shift)
        out[1:4, 1 + axis] = mass * shift
        out[4:, 1 + axis] = change[UPPER]
    # of a body that is impossible the trace may be negative
    shape = SHAPE_ERROR * max(0.5 * float(np.trace(about_centre.inertia)), 0.0)
    # half of that for products
    out[4:, 4:] = np.diag(shape * np.where(np.eye(3)[UPPER], 1.0, 0.5))
    return out


def _spread(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a^T b E - (a b^T + b a^T) / 2, the second moments of unit mass at a if b = a, (3, 3)."""
    return np.asarray(a @ b * np.eye(3) - 0.5 * (np.outer(a, b) + np.outer(b, a)))


# Pseudo-inertia: ten inertial parameters as a 4 x 4 matrix that is positive definite exactly for a real body.
#
# J = [[Sigma, h], [h^T, m]] with Sigma = int r r^T dm = tr(I) / 2 * 1 - I [kg m^2], h = m c [kg m] and the mass m [kg],
# all in the frame of the joint that moves the link; parameters in the order of
# ``gapscope.arm.dynamics.rigid_body.INERTIAL_PARAMETERS``.


BASIS = np.array(
    [pin.PseudoInertia.FromDynamicParameters(x).toMatrix() for x in np.eye(10)]
)
"""B, shape (10, 4, 4): J = sum_k pi_k B_k."""


def pseudo_inertia(parameters: np.ndarray) -> np.ndarray:
    """J of inertial parameters, shape (..., 10) to (..., 4, 4). Source: wensing2018."""
    return np.einsum("...k,kab->...ab", parameters, BASIS)


def principal_moments(bodies: np.ndarray) -> np.ndarray:
    """Moments about the centre of mass [kg m^2], ascending, shape (L, 10) to (L, 3); NaN for a mass of 0."""
    moments = np.full((len(bodies), 3), np.nan)
    for row, body in zip(moments, bodies, strict=True):
        if body[0]:
            about_centre = pin.Inertia.FromDynamicParameters(body).inertia
            row[:] = np.linalg.eigvalsh(about_centre)
    return moments


def to_log_cholesky(parameters: np.ndarray) -> np.ndarray:
    """Log-Cholesky coordinates of consistent parameters, shape (L, 10) to (L, 10).

    J = U U^T, U = e^a [[e^d1, s12, s13, t1], [0, e^d2, s23, t2], [0, 0, e^d3, t3], [0, 0, 0, 1]] with theta = (a, d1,
    d2, d3, s12, s23, s13, t1, t2, t3), as ``pinocchio.LogCholeskyParameters`` has them. Source: rucker2022.

    Raises:
        numpy.linalg.LinAlgError: the pseudo-inertia is not positive definite.
    """
    # an upper factor is the lower factor of the matrix with rows and columns reversed
    flipped = pseudo_inertia(parameters)[:, ::-1, ::-1]
    upper = np.linalg.cholesky(flipped)[:, ::-1, ::-1]
    size = upper[:, 3:, 3]
    unit = upper[:, :3] / size[:, None]
    above = [np.diagonal(unit[:, :, :3], k, 1, 2) for k in range(3)]
    theta = np.hstack([size, *above, unit[:, :, 3]])
    theta[:, :4] = np.log(theta[:, :4])
    return theta


def from_log_cholesky(theta: np.ndarray) -> np.ndarray:
    """Inertial parameters of log-Cholesky coordinates, shape (L, 10) to (L, 10); always consistent."""
    return np.array([pin.LogCholeskyParameters(x).toDynamicParameters() for x in theta])


def log_cholesky_jacobian(theta: np.ndarray) -> np.ndarray:
    """Derivative d pi / d theta, shape (L, 10) to (L, 10, 10), rows pi."""
    return np.array([pin.LogCholeskyParameters(x).calculateJacobian() for x in theta])
