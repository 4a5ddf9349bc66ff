"""Pseudo-inertia: ten inertial parameters as a 4 x 4 matrix that is positive definite exactly for a real body.

J = [[Sigma, h], [h^T, m]] with Sigma = int r r^T dm = tr(I) / 2 * 1 - I [kg m^2], h = m c [kg m] and the mass m [kg],
all in the frame of the joint that moves the link; parameters in the order of
``gapscope.arm.dynamics.rigid_body.INERTIAL_PARAMETERS``.
"""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.rigid_body import INERTIAL_PARAMETERS

_PLACES = {
    "xx": (0, 0),
    "xy": (0, 1),
    "yy": (1, 1),
    "xz": (0, 2),
    "yz": (1, 2),
    "zz": (2, 2),
}
_ABOVE_DIAGONAL = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
"""Entries of U of the last six log-Cholesky coordinates."""


def _basis() -> np.ndarray:
    """B of shape (10, 4, 4) with J = sum_k pi_k B_k."""
    basis = np.zeros((10, 4, 4))
    for k, name in enumerate(INERTIAL_PARAMETERS):
        if name == "m":
            basis[k, 3, 3] = 1.0
            continue
        if name.startswith("m"):
            axis = "xyz".index(name[1])
            basis[k, axis, 3] = 1.0
            basis[k, 3, axis] = 1.0
            continue
        i, j = _PLACES[name[1:]]
        inertia = np.zeros((3, 3))
        inertia[i, j] = 1.0
        inertia[j, i] = 1.0
        # second moments from inertia: Sigma = tr(I) / 2 - I
        basis[k, :3, :3] = np.trace(inertia) / 2 * np.eye(3) - inertia
    return basis


BASIS = _basis()
"""B, shape (10, 4, 4): J = sum_k pi_k B_k."""
_DUAL = np.linalg.solve(
    np.einsum("kab,lab->kl", BASIS, BASIS), BASIS.reshape(10, 16)
).reshape(10, 4, 4)


def pseudo_inertia(parameters: np.ndarray) -> np.ndarray:
    """J of inertial parameters, shape (..., 10) to (..., 4, 4). Source: wensing2018."""
    return np.einsum("...k,kab->...ab", parameters, BASIS)


def inertial_parameters(matrix: np.ndarray) -> np.ndarray:
    """Inertial parameters of J, shape (..., 4, 4) to (..., 10)."""
    return np.einsum("...ab,kab->...k", matrix, _DUAL)


def is_consistent(parameters: np.ndarray, tolerance: float = 0.0) -> np.ndarray:
    """Whether some body of positive mass density has these parameters, shape (..., 10) to (...).

    All eigenvalues of J exceed ``tolerance`` times its trace.
    """
    matrix = pseudo_inertia(np.asarray(parameters, dtype=float))
    least = np.linalg.eigvalsh(matrix)[..., 0]
    return least > tolerance * np.trace(matrix, axis1=-2, axis2=-1)


def central_inertia(parameters: np.ndarray) -> np.ndarray:
    """Inertia about the centre of mass [kg m^2], shape (..., 10) to (..., 3, 3); the mass must not be 0."""
    matrix = pseudo_inertia(np.asarray(parameters, dtype=float))
    moment, mass = matrix[..., :3, 3], matrix[..., 3, 3]
    of_centre = moment[..., :, None] * moment[..., None, :] / mass[..., None, None]
    second = matrix[..., :3, :3] - of_centre
    trace = np.trace(second, axis1=-2, axis2=-1)
    return trace[..., None, None] * np.eye(3) - second


def triangle_inequality(parameters: np.ndarray) -> np.ndarray:
    """Whether no principal moment about the centre of mass exceeds the sum of the others; (..., 10) to (...)."""
    moments = np.linalg.eigvalsh(central_inertia(parameters))
    return moments[..., 0] + moments[..., 1] >= moments[..., 2]


def divergence(parameters: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Entropic divergence tr(J J0^-1) - log det(J J0^-1) - 4 [1], shapes (..., 10) to (...).

    Zero if they agree and infinite at the edge of what is physical. Source: lee2020.
    """
    matrix = pseudo_inertia(np.asarray(parameters))
    product = matrix @ np.linalg.inv(pseudo_inertia(np.asarray(reference)))
    sign, log = np.linalg.slogdet(product)
    trace = np.trace(product, axis1=-2, axis2=-1)
    return np.where(sign > 0, trace - log - 4.0, np.inf)


def from_log_cholesky(theta: np.ndarray) -> np.ndarray:
    """Inertial parameters of log-Cholesky coordinates, shape (..., 10) to (..., 10); always consistent.

    J = U U^T, U = e^a [[e^d1, s12, s13, t1], [0, e^d2, s23, t2], [0, 0, e^d3, t3], [0, 0, 0, 1]] with theta = (a, d1,
    d2, d3, s12, s23, s13, t1, t2, t3). Source: rucker2022.
    """
    upper = _upper(np.asarray(theta, dtype=float))
    return inertial_parameters(upper @ np.swapaxes(upper, -1, -2))


def to_log_cholesky(parameters: np.ndarray) -> np.ndarray:
    """Log-Cholesky coordinates of consistent parameters, shape (..., 10) to (..., 10).

    Raises:
        numpy.linalg.LinAlgError: the pseudo-inertia is not positive definite.
    """
    # an upper factor is the lower factor of the matrix with rows and columns reversed
    flipped = pseudo_inertia(np.asarray(parameters, dtype=float))[..., ::-1, ::-1]
    upper = np.linalg.cholesky(flipped)[..., ::-1, ::-1]
    size = upper[..., 3, 3]
    unit = upper / size[..., None, None]
    theta = np.empty((*size.shape, 10))
    theta[..., 0] = np.log(size)
    for i in range(3):
        theta[..., 1 + i] = np.log(unit[..., i, i])
    for k, (i, j) in enumerate(_ABOVE_DIAGONAL):
        theta[..., 4 + k] = unit[..., i, j]
    return theta


def log_cholesky_jacobian(theta: np.ndarray) -> np.ndarray:
    """Derivative d pi / d theta, shape (..., 10) to (..., 10, 10), rows pi."""
    theta = np.asarray(theta, dtype=float)
    upper, size = _upper(theta), np.exp(theta[..., 0])
    # derivatives of U by each coordinate
    change = np.zeros((*theta.shape, 4, 4))
    change[..., 0, :, :] = upper
    for i in range(3):
        change[..., 1 + i, i, i] = upper[..., i, i]
    for k, (i, j) in enumerate(_ABOVE_DIAGONAL):
        change[..., 4 + k, i, j] = size
    # d(U U^T) = dU U^T and its transpose
    half = change @ np.swapaxes(upper, -1, -2)[..., None, :, :]
    rows = inertial_parameters(half + np.swapaxes(half, -1, -2))
    return np.swapaxes(rows, -1, -2)


def _upper(theta: np.ndarray) -> np.ndarray:
    """U, shape (..., 4, 4)."""
    upper = np.zeros((*theta.shape[:-1], 4, 4))
    for i in range(3):
        upper[..., i, i] = np.exp(theta[..., 1 + i])
    for k, (i, j) in enumerate(_ABOVE_DIAGONAL):
        upper[..., i, j] = theta[..., 4 + k]
    upper[..., 3, 3] = 1.0
    size = np.exp(theta[..., 0])
    return upper * size[..., None, None]
