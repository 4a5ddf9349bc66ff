"""Physically consistent least squares as a convex programme over the links' pseudo-inertias."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.errors import GapscopeError, InputError
from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.estimators.linear_estimator import Factor, finished
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
    (R^T R + gamma H)^-1, H the pull's Hessian, leaves out that the constraints tell something too.

    Attributes:
        prior: pi_0, shape (p,). Without one, the Euclidean pull is to 0 and only picks one of many equal answers.
        pull: ``euclidean`` or ``entropic``, which needs a prior.
        weight: gamma; by default 1 with a prior and 1e-4 without.
        floor: J of a link is at least this times diag(r^2, r^2, r^2, 1) m_0.

    Raises:
        InputError: no standard columns, a prior that is not physical, an entropic pull to nothing.

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
        weight = (
            (1e-4 if self.prior is None else 1.0)
            if self.weight is None
            else self.weight
        )
        value = self._solve(factor, columns, reference, weight)
        wrong = ~is_consistent(value[columns.links])
        if wrong.any():
            raise GapscopeError(
                f"the solver left {int(wrong.sum())} links without a physical body",
                "raise weight or floor",
            )
        hessian = self._hessian(value, columns, reference)
        precision = factor.triangle.T @ factor.triangle + weight * hessian
        scale = 1 / np.sqrt(np.diag(precision))
        covariance = np.linalg.pinv(
            precision * np.outer(scale, scale), hermitian=True
        ) * np.outer(scale, scale)
        return finished(problem, value, covariance, warnings)

    def _solve(
        self,
        factor: Factor,
        columns: StandardColumns,
        reference: ReferenceParameters,
        weight: float,
    ) -> np.ndarray:
        import cvxpy as cp

        units = np.empty(len(factor.rotated))
        units[columns.links], units[columns.others] = (
            reference.link_units,
            reference.other_units,
        )
        x = cp.Variable(len(units))
        target = (
            np.zeros_like(units)
            if self.prior is None
            else np.asarray(self.prior, dtype=float) / units
        )
        loss = cp.sum_squares((factor.triangle * units) @ x - factor.rotated) / 2
        drawn = np.ones(len(units), dtype=bool)
        pull = 0.0
        constraints = (
            [x[columns.others[columns.bounded]] >= 0] if columns.bounded.any() else []
        )
        for places, mass, radius, body in zip(
            columns.links,
            reference.mass,
            reference.radius,
            reference.links,
            strict=True,
        ):
            side = np.array([radius, radius, radius, 1.0]) * np.sqrt(mass)
            unit_basis = BASIS * units[places][:, None, None] / np.outer(side, side)
            matrix = cp.reshape(
                unit_basis.reshape(10, 16).T @ x[places], (4, 4), order="C"
            )
            constraints.append(matrix - self.floor * np.eye(4) >> 0)
            if self.pull == "entropic":
                inverse = np.linalg.inv(pseudo_inertia(body) / np.outer(side, side))
                pull = pull + cp.trace(inverse @ matrix) - cp.log_det(matrix)
                drawn[places] = False
        pull = (
            pull + cp.sum_squares(x[np.flatnonzero(drawn)] - target[drawn]) / 2
            if drawn.any()
            else pull
        )
        problem = cp.Problem(
            cp.Minimize((loss + weight * pull) / factor.freedom), constraints
        )
        try:
            problem.solve(solver=cp.CLARABEL)
        except cp.SolverError as error:
            raise GapscopeError(
                f"the semidefinite programme failed ({error})", "raise weight or floor"
            ) from None
        if x.value is None:
            raise GapscopeError(
                f"the semidefinite programme is {problem.status}",
                "raise weight, or lower floor",
            )
        value = x.value * units
        value[columns.others[columns.bounded]] = value[
            columns.others[columns.bounded]
        ].clip(0.0)
        return value

    def _hessian(
        self,
        value: np.ndarray,
        columns: StandardColumns,
        reference: ReferenceParameters,
    ) -> np.ndarray:
        hessian = np.zeros((len(value), len(value)))
        hessian[columns.others, columns.others] = reference.other_units**-2.0
        for places, unit in zip(columns.links, reference.link_units, strict=True):
            if self.pull == "entropic":
                turned = np.linalg.inv(pseudo_inertia(value[places])) @ BASIS
                hessian[np.ix_(places, places)] = np.einsum(
                    "kab,lba->kl", turned, turned
                )
            else:
                hessian[places, places] = unit**-2.0
        return hessian
