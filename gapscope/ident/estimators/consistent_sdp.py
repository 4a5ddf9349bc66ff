"""Physically consistent least squares as a convex programme over the links' pseudo-inertias."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gapscope.arm.errors import GapscopeError, InputError
from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.estimators.linear_estimator import Factor, finished, scaled_inverse
from gapscope.ident.estimators.standard_parameters import (
    ReferenceParameters,
    StandardColumns,
    standard_factor,
)
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.pseudo_inertia import BASIS, is_consistent, pseudo_inertia

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
