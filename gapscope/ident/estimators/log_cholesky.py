"""Physically consistent least squares without constraints, over the links' log-Cholesky coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.estimators.linear_estimator import Factor, finished
from gapscope.ident.estimators.standard_parameters import (
    ReferenceParameters,
    StandardColumns,
    standard_factor,
)
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.pseudo_inertia import (
    from_log_cholesky,
    log_cholesky_jacobian,
    to_log_cholesky,
)


@dataclass(frozen=True)
class LogCholesky:
    """Minimises |z - R pi(theta)|^2 / 2 + gamma |(theta - theta_0) / unit|^2 / 2 by Gauss-Newton in a trust region.

    Every theta is a physical body, see ``gapscope.ident.model.pseudo_inertia.from_log_cholesky``; other parameters
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
