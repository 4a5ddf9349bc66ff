"""Physical parameters from base parameters: pseudo-inertias and the nearest arm that can exist."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.arm.dynamics.rigid_body import INERTIAL_PARAMETERS
from gapscope.arm.errors import GapscopeError
from gapscope.ident.model.base_parameters import BaseParameters

# Pseudo-inertia: ten inertial parameters as a 4 x 4 matrix that is positive definite exactly for a real body.
#
# J = [[Sigma, h], [h^T, m]] with Sigma = int r r^T dm = tr(I) / 2 * 1 - I [kg m^2], h = m c [kg m] and the mass m [kg],
# all in the frame of the joint that moves the link; parameters in the order of
# ``gapscope.arm.dynamics.rigid_body.INERTIAL_PARAMETERS``.


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


# Physical parameters from base parameters: consistent bodies near the nominal arm that give the estimated torque.


LENGTH = 0.1
"""Length by which pseudo-inertias are made comparable with masses [m]."""
FLOOR = 1e-4
"""Least eigenvalue of the scaled pseudo-inertia over the link's nominal mass [1]: a radius of gyration of 1 mm."""
TOLERANCES = (1e-11, 1e-8)
"""Of the solver: the second, its own, where the first is beyond double precision [1]."""
NOT_NEGATIVE = ("I", "b", "c", "d", "s")
"""Symbols of rotor inertia and of viscous, Coulomb, Stribeck and saturating friction: none can be negative."""


@dataclass(frozen=True)
class LinkCheck:
    """Whether the parameters of one link belong to a body.

    Attributes:
        link: from 1.
        mass: [kg].
        moments: principal moments about the centre of mass [kg m^2], shape (3,), ascending; NaN for a mass of 0.
        positive_mass: whether the mass is positive.
        positive_inertia: whether all principal moments are positive.
        triangle: whether none exceeds the sum of the others.
        least: least eigenvalue of the pseudo-inertia, lengths in units of ``LENGTH`` [kg].
    """

    link: int
    mass: float
    moments: np.ndarray
    positive_mass: bool
    positive_inertia: bool
    triangle: bool
    least: float

    @property
    def consistent(self) -> bool:
        """Whether some distribution of positive mass has these parameters: the full pseudo-inertia test."""
        return self.least > 0.0


@dataclass(frozen=True)
class Physical:
    """Physically consistent parameters for estimated base parameters.

    Attributes:
        value: x, shape (p,); links consistent, rotors and friction not negative.
        before: the links' checks for the x nearest to the nominal one that gives beta exactly.
        after: the links' checks for ``value``.
        distance: (C x - beta)^T cov^-1 (C x - beta) over the number of base parameters: what consistency costs [1].
    """

    value: np.ndarray
    before: tuple[LinkCheck, ...]
    after: tuple[LinkCheck, ...]
    distance: float


def check_links(parameters: np.ndarray) -> tuple[LinkCheck, ...]:
    """The checks of links, parameters of shape (10 n,) in joint order."""
    out = []
    for number, link in enumerate(parameters.reshape(-1, 10), 1):
        mass = float(link[0])
        known = abs(mass) > 1e-12
        moments = (
            np.linalg.eigvalsh(central_inertia(link)) if known else np.full(3, np.nan)
        )
        least = float(np.linalg.eigvalsh(_scaled(pseudo_inertia(link)))[0])
        triangle = bool(triangle_inequality(link)) if known else False
        out.append(
            LinkCheck(
                link=number,
                mass=mass,
                moments=moments,
                positive_mass=mass > 0,
                positive_inertia=bool((moments > 0).all()),
                triangle=triangle,
                least=least,
            )
        )
    return tuple(out)


def consistent(
    base: BaseParameters,
    beta: np.ndarray,
    information: np.ndarray,
    nominal: np.ndarray,
    penalty: np.ndarray,
    links: int,
) -> Physical:
    """Consistent x that explains beta best, and lies nearest to the nominal one if beta leaves it open.

    Minimises (C x - beta)^T H (C x - beta) + sum_k w_k (x_k - x0_k)^2 subject to J(pi_l) >= floor for every link l, and
    to rotor inertia and friction >= 0. With H = W^T W / sigma^2 this is the constrained weighted
    least-squares fit itself.

    Args:
        base: C.
        beta: estimated base parameters, shape (b,).
        information: H, inverse of the covariance of beta, shape (b, b).
        nominal: x0, shape (p,).
        penalty: w, shape (p,); positive.
        links: number of links; x begins with ten parameters of each.

    Raises:
        GapscopeError: the solver finds no solution.

    Source: wensing2018, sousa2014.
    """
    gap_of_nominal = beta - base.combination @ nominal
    spread = nominal + _nearest(base, gap_of_nominal, penalty)
    value = _solve(base, beta, information, nominal, penalty, links)
    gap = base.combination @ value - beta
    distance = float(gap @ information @ gap) / max(base.count, 1)
    before = check_links(spread[: 10 * links])
    after = check_links(value[: 10 * links])
    return Physical(
        value=value,
        before=before,
        after=after,
        distance=distance,
    )


def _nearest(
    base: BaseParameters, change: np.ndarray, penalty: np.ndarray
) -> np.ndarray:
    """Least change of x in units of 1 / sqrt(penalty) with C dx = change, shape (p,)."""
    unit = 1.0 / np.sqrt(penalty)
    return unit * (np.linalg.pinv(base.combination * unit) @ change)


def _solve(
    base: BaseParameters,
    beta: np.ndarray,
    information: np.ndarray,
    nominal: np.ndarray,
    penalty: np.ndarray,
    links: int,
) -> np.ndarray:
    """The unconstrained solution if it is possible, else the best possible one, shape (p,)."""
    C = base.combination
    normal = C.T @ information @ C + np.diag(penalty)
    right = C.T @ information @ (beta - C @ nominal)
    bounded = [
        k
        for k in range(10 * links, len(base.names))
        if _symbol(base.names[k]) in NOT_NEGATIVE
    ]
    return nearest_possible(normal, right, nominal, links, bounded)


def nearest_possible(
    normal: np.ndarray,
    right: np.ndarray,
    nominal: np.ndarray,
    links: int,
    bounded: Sequence[int] = (),
) -> np.ndarray:
    """X that minimises (x - x0)^T N (x - x0) / 2 - r^T (x - x0), its bodies consistent, shape (p,).

    Args:
        normal: N, shape (p, p), positive definite.
        right: r, shape (p,).
        nominal: x0, shape (p,); x begins with ten parameters of each link.
        links: number of links.
        bounded: places of x that may not be negative.

    Raises:
        GapscopeError: the solver finds no solution.
    """
    # columns differ by orders of magnitude: scaled to a unit diagonal
    unit = 1.0 / np.sqrt(np.diag(normal))
    scaled = normal * unit[:, None] * unit
    root = np.linalg.cholesky(scaled + 1e-13 * np.eye(len(unit))).T
    target = np.linalg.solve(root.T, unit * right)
    free = nominal + unit * np.linalg.solve(root, target)
    bodies = free[: 10 * links].reshape(-1, 10)
    least = np.linalg.eigvalsh(_scaled(pseudo_inertia(bodies)))[:, 0]
    mass = np.maximum(nominal[: 10 * links : 10], 1e-2)
    # no constraint is active: the semidefinite programme would only add its tolerance
    if (least >= FLOOR * mass).all() and (free[list(bounded)] >= 0).all():
        return free
    value = _constrained(root, target, unit, nominal, mass, list(bounded))
    if not is_consistent(value[: 10 * links].reshape(-1, 10)).all():
        raise GapscopeError("no physically consistent parameters were found", _REMEDY)
    return value


def _constrained(
    root: np.ndarray,
    target: np.ndarray,
    unit: np.ndarray,
    nominal: np.ndarray,
    mass: np.ndarray,
    bounded: list[int],
) -> np.ndarray:
    """X = x0 + unit z with z = argmin |root z - target|^2, links possible and ``bounded`` not negative; shape (p,)."""
    import cvxpy as cp  # takes a second to import, needed only here

    size = max(float(np.linalg.norm(target)), 1e-9)
    change = cp.Variable(len(unit))
    x = nominal + size * cp.multiply(unit, change)
    constraints = []
    for link, own_mass in enumerate(mass):
        own = x[10 * link : 10 * link + 10]
        matrix = sum(own[k] * _scaled(BASIS[k] / own_mass) for k in range(10))
        constraints.append(matrix >> FLOOR * np.eye(4))
    if bounded:
        constraints.append(
            change[bounded] >= -nominal[bounded] / (size * unit[bounded])
        )
    problem = cp.Problem(
        cp.Minimize(cp.sum_squares(root @ change - target / size)), constraints
    )
    with warnings.catch_warnings():  # an inaccurate solution is checked afterwards
        warnings.simplefilter("ignore", UserWarning)
        for tolerance in TOLERANCES:
            try:
                problem.solve(
                    solver=cp.CLARABEL,
                    tol_gap_abs=tolerance,
                    tol_gap_rel=tolerance,
                    tol_feas=10 * tolerance,
                )
                break
            except cp.error.SolverError as error:
                failure = error
        else:
            raise GapscopeError(
                f"no physically consistent parameters were found ({failure})", _REMEDY
            )
    if change.value is None:
        raise GapscopeError(
            f"no physically consistent parameters were found ({problem.status})",
            _REMEDY,
        )
    out = np.asarray(nominal + size * unit * change.value)
    out[bounded] = np.maximum(out[bounded], 0.0)
    return out


_REMEDY = "check the nominal masses and inertias, the unit of the torque and the joints' zeros"


def _symbol(name: str) -> str:
    """``b`` of ``b3`` and ``b6m``."""
    return (
        name.rstrip("m").rstrip("0123456789")
        if name[-1] == "m" and len(name) > 1
        else name.rstrip("0123456789")
    )


def _scaled(matrix: np.ndarray) -> np.ndarray:
    """A pseudo-inertia with lengths in units of ``LENGTH`` [kg]."""
    unit = np.array([1 / LENGTH, 1 / LENGTH, 1 / LENGTH, 1.0])
    return matrix * unit[:, None] * unit


def inconsistent(checks: Sequence[LinkCheck]) -> tuple[LinkCheck, ...]:
    """The links that are not physical."""
    return tuple(check for check in checks if not check.consistent)
