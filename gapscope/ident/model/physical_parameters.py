"""Physical parameters from base parameters: the nearest arm that can exist, and its file."""

from __future__ import annotations

import re
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.arm.dynamics.inertials import (
    BASIS,
    principal_moments,
    pseudo_inertia,
)
from gapscope.arm.dynamics.plain_urdf import exact_urdf, moving_links, set_limit
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.nominal import NominalArm
from gapscope.ident.model.base_parameters import BaseParameters

# Physical parameters from base parameters: consistent bodies near the nominal arm that give the estimated torque.


LENGTH = 0.1
"""Length by which pseudo-inertias are made comparable with masses [m]."""
LEAST_MASS = 1e-2
"""Links of almost no mass may still gain some [kg]."""
FLOOR = 1e-4
"""Least eigenvalue of the scaled pseudo-inertia over the link's nominal mass [1]: a radius of gyration of 1 mm."""
TOLERANCE = 1e-11
"""Of the solver; its own where this is beyond double precision [1]."""
_NOT_NEGATIVE = re.compile(r"[Ibcds]\d+m?")
"""Names of rotor inertia and of viscous, Coulomb, Stribeck and saturating friction: none can be negative."""


@dataclass(frozen=True)
class LinkCheck:
    """Whether the parameters of one link belong to a body.

    Attributes:
        link: from 1.
        mass: [kg].
        moments: principal moments about the centre of mass [kg m^2], shape (3,), ascending; NaN for a mass of 0.
        least: least eigenvalue of the pseudo-inertia, lengths in units of ``LENGTH`` [kg].
    """

    link: int
    mass: float
    moments: np.ndarray
    least: float

    @property
    def positive_mass(self) -> bool:
        """Whether the mass is positive."""
        return self.mass > 0

    @property
    def positive_inertia(self) -> bool:
        """Whether all principal moments are positive."""
        return bool((self.moments > 0).all())

    @property
    def triangle(self) -> bool:
        """Whether no principal moment exceeds the sum of the others."""
        return bool(self.moments[0] + self.moments[1] >= self.moments[2])

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
    """

    value: np.ndarray
    before: tuple[LinkCheck, ...]
    after: tuple[LinkCheck, ...]


def check_links(parameters: np.ndarray) -> tuple[LinkCheck, ...]:
    """The checks of links, parameters of shape (10 n,) in joint order."""
    bodies = parameters.reshape(-1, 10)
    least = np.linalg.eigvalsh(_scaled(pseudo_inertia(bodies)))[:, 0]
    rows = zip(bodies[:, 0].tolist(), principal_moments(bodies), least, strict=True)
    return tuple(LinkCheck(link, *row) for link, row in enumerate(rows, 1))


def inconsistent(checks: Sequence[LinkCheck]) -> tuple[LinkCheck, ...]:
    """The links that are not physical."""
    return tuple(check for check in checks if not check.consistent)


def not_negative(names: Sequence[str]) -> list[int]:
    """Places of parameters that take energy or store it."""
    return [k for k, name in enumerate(names) if _NOT_NEGATIVE.fullmatch(name)]


def link_count(names: Sequence[str]) -> int:
    """Number of links whose bodies are among parameters."""
    return sum(name.rstrip("0123456789") == "m" for name in names)


def consistent(
    base: BaseParameters,
    beta: np.ndarray,
    information: np.ndarray,
    nominal: np.ndarray,
    penalty: np.ndarray,
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

    Raises:
        GapscopeError: the solver finds no solution.

    Source: wensing2018, sousa2014.
    """
    C, left = base.combination, beta - base.combination @ nominal
    normal = C.T @ information @ C + np.diag(penalty)
    right = C.T @ information @ left
    value = nearest_possible(normal, right, nominal, base.names)
    # the least change in units of the pull that gives beta exactly
    unit = 1.0 / np.sqrt(penalty)
    free = nominal + unit * (np.linalg.pinv(C * unit) @ left)
    bodies = slice(10 * link_count(base.names))
    return Physical(value, check_links(free[bodies]), check_links(value[bodies]))


def nearest_possible(
    normal: np.ndarray,
    right: np.ndarray,
    nominal: np.ndarray,
    names: Sequence[str],
) -> np.ndarray:
    """X that minimises (x - x0)^T N (x - x0) / 2 - r^T (x - x0), its bodies consistent, shape (p,).

    Args:
        normal: N, shape (p, p), positive definite.
        right: r, shape (p,).
        nominal: x0, shape (p,).
        names: of the parameters; x begins with ten of each link.

    Raises:
        GapscopeError: the solver finds no solution.
    """
    # columns differ by orders of magnitude: scaled to a unit diagonal
    unit = 1.0 / np.sqrt(np.diag(normal))
    scaled = normal * unit[:, None] * unit
    root = np.linalg.cholesky(scaled + 1e-13 * np.eye(len(unit))).T
    target = np.linalg.solve(root.T, unit * right)
    free = nominal + unit * np.linalg.solve(root, target)
    links = link_count(names)
    least = np.array([check.least for check in check_links(free[: 10 * links])])
    # no constraint is active: the semidefinite programme would only add its tolerance
    if (least >= FLOOR * _masses(nominal, links)).all() and (
        free[not_negative(names)] >= 0
    ).all():
        return free
    return possible_least_squares(root, target, unit, nominal, names)


def possible_least_squares(
    root: np.ndarray,
    target: np.ndarray,
    unit: np.ndarray,
    nominal: np.ndarray,
    names: Sequence[str],
    entropic: float = 0.0,
) -> np.ndarray:
    """X = x0 + unit z, shape (p,), with z = argmin |A z - y|^2 / 2 + w sum_l (tr(J_l J_0l^-1) - log det J_l).

    Args:
        root: A, shape (M, p).
        target: y, shape (M,).
        unit: of each parameter, shape (p,), in which they are of about the same size.
        nominal: x0, shape (p,).
        names: of the parameters; x begins with ten of each link, which gets a body that is possible.
        entropic: w, how strongly each body J is drawn to the nominal one J_0 by the entropic divergence.

    Raises:
        GapscopeError: the solver finds no solution.

    Source: wensing2018, lee2020.
    """
    import cvxpy as cp  # takes a second to import, needed only here

    links, bounded = link_count(names), not_negative(names)
    mass = _masses(nominal, links)
    size = float(np.linalg.norm(target)) or 1.0
    change = cp.Variable(len(unit))
    x = nominal + size * cp.multiply(unit, change)
    constraints = [x[bounded] / (size * unit[bounded]) >= 0] if bounded else []
    cost = cp.sum_squares(root @ change - target / size)
    for link in range(links):
        own = slice(10 * link, 10 * link + 10)
        basis = _scaled(BASIS / mass[link])
        matrix = cp.reshape(basis.reshape(10, 16).T @ x[own], (4, 4), order="C")
        constraints.append(matrix >> FLOOR * np.eye(4))
        if entropic:
            inverse = np.linalg.inv(np.tensordot(nominal[own], basis, axes=1))
            pull = cp.trace(inverse @ matrix) - cp.log_det(matrix)
            cost += 2 * entropic / size**2 * pull
    problem = cp.Problem(cp.Minimize(cost), constraints)
    failure = None
    with warnings.catch_warnings():  # an inaccurate solution is checked afterwards
        warnings.simplefilter("ignore", UserWarning)
        tight = {"tol_gap_abs": TOLERANCE, "tol_gap_rel": TOLERANCE}
        for settings in ({**tight, "tol_feas": 10 * TOLERANCE}, {}):
            try:
                problem.solve(solver=cp.CLARABEL, **settings)
                break
            except cp.error.SolverError as error:
                failure = error
    out = nominal
    if change.value is not None:
        out = nominal + size * unit * change.value
        out[bounded] = np.maximum(out[bounded], 0.0)
    if change.value is None or inconsistent(check_links(out[: 10 * links])):
        raise GapscopeError(
            f"no physically consistent parameters were found ({failure or problem.status})",
            "check the nominal masses and inertias, the unit of the torque and the joints' zeros",
        )
    return out


def _masses(nominal: np.ndarray, links: int) -> np.ndarray:
    """Masses that count as one of each link [kg], shape (L,)."""
    return np.maximum(nominal[: 10 * links : 10], LEAST_MASS)


def _scaled(matrix: np.ndarray) -> np.ndarray:
    """A pseudo-inertia with lengths in units of ``LENGTH`` [kg]."""
    unit = np.array([1 / LENGTH, 1 / LENGTH, 1 / LENGTH, 1.0])
    return matrix * unit[:, None] * unit


# The arm that can exist as a file that other tools read.


def urdf_text(arm: NominalArm, body: RigidBody) -> str:
    """URDF of bodies of an arm: the nominal arm's kinematics and limits, one link per joint, no shapes.

    Frames and axes are those of the nominal arm's joints; inertial frames lie along the principal axes.
    """
    root = exact_urdf(arm.name, moving_links(body))
    # limits of the nominal arm
    speed, effort = body.velocity_limits(), body.effort_limits()
    for joint in root.findall("joint"):
        j = arm.joints.index(joint.get("name", ""))
        set_limit(joint, effort[j], speed[j])
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"
