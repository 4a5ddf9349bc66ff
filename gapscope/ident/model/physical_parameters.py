"""Physical parameters from base parameters: consistent bodies near the nominal arm that give the estimated torque."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.arm.errors import GapscopeError
from gapscope.ident.model.base_parameters import BaseParameters
from gapscope.ident.model.pseudo_inertia import (
    BASIS,
    central_inertia,
    is_consistent,
    pseudo_inertia,
    triangle_inequality,
)

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
