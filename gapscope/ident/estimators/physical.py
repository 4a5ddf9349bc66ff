"""Estimators of arms that can exist: semidefinite programme, log-Cholesky parameters, triangles of a joint's bodies."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from gapscope.arm.dynamics.rigid_body import INERTIAL_PARAMETERS
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.root_mean_square import rms
from gapscope.ident.estimators.linear import (
    Estimate,
    column_norms,
    finished,
    joint_noise,
    scaled_inverse,
    whitened,
)
from gapscope.ident.model.base_parameters import Factor
from gapscope.ident.model.linear_problem import Problem, check_samples, unit_warnings
from gapscope.ident.model.physical_parameters import (
    BASIS,
    from_log_cholesky,
    is_consistent,
    log_cholesky_jacobian,
    pseudo_inertia,
    to_log_cholesky,
)

# What estimators of standard parameters share: which columns belong to which link, a reference body, the factor.


NOT_NEGATIVE = re.compile(r"[Ibcds]\d+")
"""Names of rotor inertia, viscous and Coulomb friction, which take energy or store it and cannot be negative."""
REFERENCE_MASS = 1.0
"""Mass of the body that replaces a link if there is no prior [kg]."""
REFERENCE_RADIUS = 0.1
"""Its radius of gyration about each plane [m]."""
MIN_NOISE = 1e-4
"""Noise is taken to be at least this share of the torque's RMS, which keeps the programme well scaled [1]."""


@dataclass(frozen=True)
class StandardColumns:
    """Columns of standard parameters, L links.

    Attributes:
        links: places of each link's ten parameters, shape (L, 10).
        others: places of the rest, shape (o,).
        bounded: which of those may not be negative, shape (o,).
    """

    links: np.ndarray
    others: np.ndarray
    bounded: np.ndarray

    @classmethod
    def of(cls, names: Sequence[str]) -> StandardColumns:
        """Found by name; raises ``InputError`` if no link has all ten parameters in their order."""
        names = tuple(names)
        starts = [
            i
            for i, name in enumerate(names)
            if re.fullmatch(r"m\d+", name)
            and names[i : i + 10]
            == tuple(f"{parameter}{name[1:]}" for parameter in INERTIAL_PARAMETERS)
        ]
        if not starts:
            raise InputError(
                "no link has its ten standard parameters among the columns",
                "build the problem from all columns of Regressor.matrix, not from base columns",
                where="names",
            )
        links = np.array(starts)[:, None] + np.arange(10)
        others = np.setdiff1d(np.arange(len(names)), links)
        bounded = np.array(
            [NOT_NEGATIVE.fullmatch(names[i]) is not None for i in others], dtype=bool
        )
        if any(re.fullmatch(r"m[xyz]?\d+|I[xyz]{2}\d+", names[i]) for i in others):
            raise InputError(
                "some link lacks some of its ten parameters",
                "give all ten, in order",
                where="names",
            )
        return cls(links, others, bounded)


@dataclass(frozen=True)
class ReferenceParameters:
    """The bodies and coefficients that a pull draws to.

    Attributes:
        links: inertial parameters, shape (L, 10), consistent.
        mass: the unit of mass per link [kg], shape (L,).
        radius: the unit of length per link [m], shape (L,).
        others: shape (o,).
        other_units: what counts as a change of one, shape (o,).
    """

    links: np.ndarray
    mass: np.ndarray
    radius: np.ndarray
    others: np.ndarray
    other_units: np.ndarray

    @classmethod
    def of(
        cls, columns: StandardColumns, prior: np.ndarray | None, names: Sequence[str]
    ) -> ReferenceParameters:
        """Of a prior, shape (p,), or the same body for every link if there is none."""
        if prior is None:
            return cls._same_body(columns)
        prior = np.asarray(prior, dtype=float)
        links, others = prior[columns.links], prior[columns.others]
        wrong = np.flatnonzero(~is_consistent(links))
        if len(wrong):
            raise InputError(
                f"the prior of {names[columns.links[wrong[0], 0]]} and its link is no physical body",
                "correct mass, centre of mass and inertia in the URDF, or estimate without a prior",
                where="prior",
            )
        mass = links[:, 0]
        # radius of gyration: the mean second moment over the mass
        second = np.trace(pseudo_inertia(links)[:, :3, :3], axis1=1, axis2=2)
        radius = np.sqrt(second / 3 / mass)
        units = np.where(np.abs(others) > 0, np.abs(others), 1.0)
        return cls(
            links=links,
            mass=mass,
            radius=radius,
            others=others,
            other_units=units,
        )

    @classmethod
    def _same_body(cls, columns: StandardColumns) -> ReferenceParameters:
        """A ball of ``REFERENCE_MASS`` and ``REFERENCE_RADIUS`` for every link."""
        count = len(columns.links)
        inertia = 2 * REFERENCE_MASS * REFERENCE_RADIUS**2
        body = [REFERENCE_MASS, 0, 0, 0, inertia, 0, inertia, 0, 0, inertia]
        zeros = np.zeros(len(columns.others))
        return cls(
            links=np.tile(np.array(body, dtype=float), (count, 1)),
            mass=np.full(count, REFERENCE_MASS),
            radius=np.full(count, REFERENCE_RADIUS),
            others=zeros,
            other_units=zeros + 1.0,
        )

    @property
    def link_units(self) -> np.ndarray:
        """What counts as a change of one of each inertial parameter, shape (L, 10)."""
        powers = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
        return self.mass[:, None] * self.radius[:, None] ** powers


def standard_factor(
    problem: Problem, prior: np.ndarray | None
) -> tuple[Factor, tuple[str, ...]]:
    """Equations whitened per joint as a triangle of standard columns, which may lack rank; and warnings of the unit.

    Raises:
        InputError: the samples are not finite, or the arm rests.
    """
    check_samples(problem, full_rank=False)
    factor = Factor.of(*problem.stacked())
    norms = column_norms(factor.triangle)
    unit = factor.triangle / norms
    free = np.linalg.lstsq(unit, factor.rotated, rcond=1e-9)[0] / norms
    warnings: tuple[str, ...] = ()
    if prior is not None:
        warnings = unit_warnings(problem, np.asarray(prior, dtype=float))
    least = MIN_NOISE * float(rms(problem.torque, axis=None))
    # standard columns lack rank: a free fit serves for the noise alone
    noise = np.maximum(joint_noise(problem, free), least)
    return Factor.of(*whitened(problem, noise)), warnings


# Physically consistent least squares without constraints, over the links' log-Cholesky coordinates.


@dataclass(frozen=True)
class LogCholesky:
    """Minimises |z - R pi(theta)|^2 / 2 + gamma |(theta - theta_0) / unit|^2 / 2 by Gauss-Newton in a trust region.

    Every theta is a physical body, see ``gapscope.ident.model.physical_parameters.from_log_cholesky``; other parameters
    stay as they are, those of friction and rotors at 0 or above. theta_0 is that of the prior, where the search
    starts too. Its units are 1 for the logarithms and the radius of gyration for the lengths. The covariance is that
    of the linearisation, P (J^T J + gamma U^-2)^-1 P^T with P = d pi / d theta.

    Attributes:
        prior: pi_0, shape (p,), consistent; a body of 1 kg for every link if ``None``.
        weight: gamma; by default 1 with a prior and 0.01 without.
        rounds: most evaluations.

    Source: rucker2022.
    """

    prior: np.ndarray | None = None
    weight: float | None = None
    rounds: int = 500

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate standard parameters; raises ``InputError`` if columns, prior or samples cannot be used."""
        columns = StandardColumns.of(problem.names)
        reference = ReferenceParameters.of(columns, self.prior, problem.names)
        factor, warnings = standard_factor(problem, self.prior)
        weight = (
            (1e-2 if self.prior is None else 1.0)
            if self.weight is None
            else self.weight
        )
        search = _Search(factor, columns, reference, weight)
        found = least_squares(
            search.residual,
            search.start,
            search.jacobian,
            bounds=search.bounds,
            x_scale="jac",
            max_nfev=self.rounds,
        )
        if found.status == 0:
            warnings += (
                f"the search had not ended after {self.rounds} evaluations; give more rounds or a prior",
            )
        jacobian, change = search.jacobian(found.x), search.change(found.x)
        free = change @ np.linalg.pinv(jacobian)
        return finished(problem, search.parameters(found.x), free @ free.T, warnings)


class _Search:
    """The search in coordinates y: theta of every link, then the other parameters."""

    def __init__(
        self,
        factor: Factor,
        columns: StandardColumns,
        reference: ReferenceParameters,
        weight: float,
    ) -> None:
        self._factor, self._columns = factor, columns
        self._pull = np.sqrt(weight)
        theta = to_log_cholesky(reference.links)
        # the first four coordinates are logarithms, the other six lengths
        powers = np.array([0, 0, 0, 0, 1, 1, 1, 1, 1, 1])
        # first moments count in radii
        link_units = reference.radius[:, None] ** powers
        self._units = np.concatenate([link_units.ravel(), reference.other_units])
        self._centre = np.concatenate([theta.ravel(), reference.others])
        lower_others = np.where(columns.bounded, 0.0, -np.inf)
        lower = np.concatenate([np.full(theta.size, -np.inf), lower_others])
        self.bounds = (lower, np.inf)
        # the search begins strictly inside its bounds
        inside = np.where(np.isfinite(lower), 1e-3 * self._units, -np.inf)
        self.start = np.maximum(self._centre, inside)

    def parameters(self, y: np.ndarray) -> np.ndarray:
        """Pi, shape (p,)."""
        links = self._columns.links
        theta = y[: links.size].reshape(links.shape)
        parameters = np.empty(len(y))
        parameters[links] = from_log_cholesky(theta)
        parameters[self._columns.others] = y[links.size :]
        return parameters

    def change(self, y: np.ndarray) -> np.ndarray:
        """P = d pi / d y, shape (p, p)."""
        links, others = self._columns.links, self._columns.others
        theta = y[: links.size].reshape(links.shape)
        derivative = np.zeros((len(y), len(y)))
        for k, block in enumerate(log_cholesky_jacobian(theta)):
            rows = links[k][:, None]
            derivative[rows, 10 * k + np.arange(10)] = block
        derivative[others, links.size + np.arange(len(others))] = 1.0
        return derivative

    def residual(self, y: np.ndarray) -> np.ndarray:
        """Residuals of the equations and of the pull, shape (2 p,)."""
        data = self._factor.triangle @ self.parameters(y) - self._factor.rotated
        return np.concatenate([data, self._pull * (y - self._centre) / self._units])

    def jacobian(self, y: np.ndarray) -> np.ndarray:
        """Its derivative, shape (2 p, p)."""
        return np.vstack(
            [self._factor.triangle @ self.change(y), np.diag(self._pull / self._units)]
        )


# Physically consistent least squares as a convex programme over the links' pseudo-inertias.


PULLS = ("euclidean", "entropic")


@dataclass(frozen=True)
class ConsistentSdp:
    """Minimises |z - R pi|^2 / 2 + gamma pull(pi), every link's J positive definite and friction not negative.

    Standard parameters pi; z and R are the triangle of the equations, whitened per joint, so that gamma counts
    equations. The pull is sum ((pi - pi_0) / unit)^2 / 2 (``euclidean``; units mass, mass times radius of gyration,
    mass times its square) or per link tr(J J_0^-1) - log det(J J_0^-1) - 4 (``entropic``), which does not depend on
    the frame and keeps off the edge of what is physical; other parameters are pulled Euclidean. The covariance
    (R^T R + gamma H)^-1, H the pull's Hessian, does not count the information of the constraints.

    Attributes:
        prior: pi_0, shape (p,). Without one, the Euclidean pull is to 0 and only picks one of many equal answers.
        pull: ``euclidean`` or ``entropic``, which needs a prior.
        weight: gamma; by default 1 with a prior and 1e-4 without.
        floor: J of a link is at least this times diag(r^2, r^2, r^2, 1) m_0.

    Raises:
        InputError: no standard columns, a prior that is not physical, an entropic pull without a prior.

    Source: wensing2018, lee2020.
    """

    prior: np.ndarray | None = None
    pull: str = "euclidean"
    weight: float | None = None
    floor: float = 1e-4

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate standard parameters; raises ``GapscopeError`` if the solver fails."""
        if self.pull not in PULLS or (self.pull == "entropic" and self.prior is None):
            raise InputError(
                f"a pull is {' or '.join(PULLS)}, and the latter needs a prior",
                where="pull",
            )
        columns = StandardColumns.of(problem.names)
        reference = ReferenceParameters.of(columns, self.prior, problem.names)
        factor, warnings = standard_factor(problem, self.prior)
        weight = self.weight
        if weight is None:
            weight = 1e-4 if self.prior is None else 1.0
        value = self._solve(factor, columns, reference, weight)
        wrong = ~is_consistent(value[columns.links])
        if wrong.any():
            raise GapscopeError(
                f"the solver left {int(wrong.sum())} links without a physical body",
                "raise weight or floor",
            )
        hessian = self._hessian(value, columns, reference)
        precision = factor.triangle.T @ factor.triangle + weight * hessian
        return finished(problem, value, scaled_inverse(precision), warnings)

    def _solve(
        self,
        factor: Factor,
        columns: StandardColumns,
        reference: ReferenceParameters,
        weight: float,
    ) -> np.ndarray:
        """Solution of the semidefinite programme, in units in which every parameter is near 1."""
        import cvxpy as cp

        units = np.empty(len(factor.rotated))
        units[columns.links] = reference.link_units
        units[columns.others] = reference.other_units
        x = cp.Variable(len(units))
        not_negative = columns.others[columns.bounded]
        constraints = [x[not_negative] >= 0] if len(not_negative) else []
        matrices = []
        for link in range(len(columns.links)):
            basis = _unit_basis(columns, reference, units, link)
            product = basis.reshape(10, 16).T @ x[columns.links[link]]
            matrix = cp.reshape(product, (4, 4), order="C")
            constraints.append(matrix - self.floor * np.eye(4) >> 0)
            matrices.append(matrix)
        pull = self._pull(x, matrices, columns, reference, units)
        predicted = (factor.triangle * units) @ x
        loss = cp.sum_squares(predicted - factor.rotated) / 2
        objective = cp.Minimize((loss + weight * pull) / factor.freedom)
        programme = cp.Problem(objective, constraints)
        try:
            programme.solve(solver=cp.CLARABEL)
        except cp.SolverError as error:
            raise GapscopeError(
                f"the semidefinite programme failed ({error})", "raise weight or floor"
            ) from None
        # infeasible or unbounded, without an error
        if x.value is None:
            raise GapscopeError(
                f"the semidefinite programme is {programme.status}",
                "raise weight, or lower floor",
            )
        value: np.ndarray = x.value * units
        # the solver keeps bounds to its tolerance only
        value[not_negative] = value[not_negative].clip(0.0)
        return value

    def _pull(
        self,
        x: Any,
        matrices: list[Any],
        columns: StandardColumns,
        reference: ReferenceParameters,
        units: np.ndarray,
    ) -> Any:
        """The pull's penalty as an expression of the programme's variable."""
        import cvxpy as cp

        target = np.zeros_like(units)
        if self.prior is not None:
            target = np.asarray(self.prior, dtype=float) / units
        if self.pull != "entropic":
            return cp.sum_squares(x - target) / 2
        pull = 0.0
        for link, matrix in enumerate(matrices):
            outer = _side_products(reference, link)
            inverse = np.linalg.inv(pseudo_inertia(reference.links[link]) / outer)
            pull = pull + cp.trace(inverse @ matrix) - cp.log_det(matrix)
        if len(columns.others):
            others = np.sort(columns.others)
            pull = pull + cp.sum_squares(x[others] - target[others]) / 2
        return pull

    def _hessian(
        self,
        value: np.ndarray,
        columns: StandardColumns,
        reference: ReferenceParameters,
    ) -> np.ndarray:
        """Second derivative of the pull at the estimate, shape (p, p)."""
        hessian = np.zeros((len(value), len(value)))
        hessian[columns.others, columns.others] = reference.other_units**-2.0
        for places, unit in zip(columns.links, reference.link_units, strict=True):
            if self.pull != "entropic":
                hessian[places, places] = unit**-2.0
                continue
            # second derivative of -log det J: tr(J^-1 B_k J^-1 B_l)
            turned = np.linalg.inv(pseudo_inertia(value[places])) @ BASIS
            block = np.einsum("kab,lba->kl", turned, turned)
            hessian[np.ix_(places, places)] = block
        return hessian


def _side_products(reference: ReferenceParameters, link: int) -> np.ndarray:
    """Units of the entries of a link's pseudo-inertia, shape (4, 4)."""
    radius, mass = reference.radius[link], reference.mass[link]
    side = np.array([radius, radius, radius, 1.0]) * np.sqrt(mass)
    return np.outer(side, side)


def _unit_basis(
    columns: StandardColumns,
    reference: ReferenceParameters,
    units: np.ndarray,
    link: int,
) -> np.ndarray:
    """Pseudo-inertia of a link per parameter, both in their units, shape (10, 4, 4)."""
    own = units[columns.links[link]][:, None, None]
    return BASIS * own / _side_products(reference, link)
