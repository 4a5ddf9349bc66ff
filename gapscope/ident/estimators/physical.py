"""Estimators of arms that can exist: log-Cholesky coordinates, and a convex programme over pseudo-inertias."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from gapscope.arm.errors import InputError
from gapscope.arm.root_mean_square import rms
from gapscope.ident.estimators.linear import (
    Estimate,
    finished,
    free_fit,
    joint_noise,
    whitened,
)
from gapscope.ident.model.base_parameters import BaseParameters, Factor
from gapscope.ident.model.linear_problem import Problem, check_samples, unit_warnings
from gapscope.ident.model.physical_parameters import (
    BASIS,
    check_links,
    from_log_cholesky,
    inconsistent,
    log_cholesky_jacobian,
    not_negative,
    possible_least_squares,
    pseudo_inertia,
    to_log_cholesky,
)

MIN_NOISE = 1e-4
"""Noise is taken to be at least this share of the torque's RMS, which keeps the equations well scaled [1]."""


@dataclass(frozen=True)
class Possible(ABC):
    """Base parameters beta = C pi of bodies pi that can exist, near those of a prior.

    Minimises |z - R C pi|^2 / 2 + gamma pull(pi) with the triangle R, z of the equations, whitened per joint, so that
    gamma counts equations.

    Attributes:
        prior: pi_0, shape (p,), of bodies that can exist; first ten parameters of each link.
        base: C, shape (b, p); the base parameters are those of the problem.
        weight: gamma.
    """

    prior: np.ndarray
    base: BaseParameters
    weight: float = 1.0

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate base parameters.

        Raises:
            InputError: samples are not finite, the arm rests, or a body of the prior cannot exist.
            GapscopeError: the solver finds no solution.
        """
        check_samples(problem, full_rank=False)
        if wrong := inconsistent(check_links(self.prior[: 10 * self.links])):
            raise InputError(
                f"the prior of link {wrong[0].link} is no physical body",
                "correct mass, centre of mass and inertia in the URDF, or use an estimator without bodies",
                where="prior",
            )
        C = self.base.combination
        least = MIN_NOISE * float(rms(problem.torque, axis=None))
        free = free_fit(problem, C @ self.prior)
        noise = np.maximum(joint_noise(problem, free), least)
        factor = Factor.of(*whitened(problem, noise))
        value, covariance, warnings = self.bodies(factor.triangle @ C, factor.rotated)
        warnings = unit_warnings(problem, C @ self.prior) + warnings
        return finished(problem, C @ value, C @ covariance @ C.T, warnings)

    @abstractmethod
    def bodies(
        self, matrix: np.ndarray, torque: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
        """Pi, (p,), its covariance, (p, p), and warnings, by white equations of shape (b, p) and (b,)."""

    @property
    def links(self) -> int:
        """Number L of links."""
        return sum(name.rstrip("0123456789") == "m" for name in self.base.names)

    @property
    def radius(self) -> np.ndarray:
        """Radius of gyration of each link of the prior: the mean second moment over the mass [m], shape (L, 1)."""
        bodies = self.prior[: 10 * self.links].reshape(-1, 10)
        second = np.trace(pseudo_inertia(bodies)[:, :3, :3], axis1=1, axis2=2)
        return np.sqrt(second / 3 / bodies[:, 0])[:, None]

    def units(self, of_links: np.ndarray) -> np.ndarray:
        """What counts as a change of one: given for the links, (L, 10); of the others their size, shape (p,)."""
        others = np.abs(self.prior[of_links.size :])
        return np.append(of_links.ravel(), np.where(others > 0, others, 1.0))


# Physically consistent least squares without constraints, over the links' log-Cholesky coordinates.


@dataclass(frozen=True)
class LogCholesky(Possible):
    """Gauss-Newton in a trust region over theta, with the pull |(theta - theta_0) / unit|^2 / 2.

    Every theta is a physical body, see ``gapscope.ident.model.physical_parameters.from_log_cholesky``; other parameters
    stay as they are, those of friction and rotors at 0 or above. theta_0 is that of the prior, where the search
    starts too. Its units are 1 for the logarithms and the radius of gyration for the lengths. The covariance is that
    of the linearisation, P (J^T J + gamma U^-2)^-1 P^T with P = d pi / d theta.

    Source: rucker2022.
    """

    def bodies(
        self, matrix: np.ndarray, torque: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
        """By ``scipy.optimize.least_squares``."""
        end = 10 * self.links
        links, others = np.split(self.prior, [end])
        centre = np.append(to_log_cholesky(links.reshape(-1, 10)), others)
        # the first four coordinates are logarithms, the other six lengths
        units = self.units(self.radius ** np.repeat([0, 1], [4, 6]))
        pull = np.sqrt(self.weight) / units
        lower = np.full(len(centre), -np.inf)
        lower[not_negative(self.base.names)] = 0.0

        def parameters(y: np.ndarray) -> np.ndarray:
            return np.append(from_log_cholesky(y[:end].reshape(-1, 10)), y[end:])

        def change(y: np.ndarray) -> np.ndarray:
            by_theta = log_cholesky_jacobian(y[:end].reshape(-1, 10))
            return block_diag(*by_theta, np.eye(len(y) - end))

        def residual(y: np.ndarray) -> np.ndarray:
            return np.append(matrix @ parameters(y) - torque, pull * (y - centre))

        def jacobian(y: np.ndarray) -> np.ndarray:
            return np.vstack([matrix @ change(y), np.diag(pull)])

        found = least_squares(
            residual,
            # the search begins strictly inside its bounds
            np.where(np.isfinite(lower), np.maximum(centre, 1e-3 * units), centre),
            jacobian,
            bounds=(lower, np.inf),
            x_scale="jac",
        )
        free = change(found.x) @ np.linalg.pinv(jacobian(found.x))
        warnings = (
            () if found.status else (f"the search had not ended: {found.message}",)
        )
        return parameters(found.x), free @ free.T, warnings


# Physically consistent least squares as a convex programme over the links' pseudo-inertias.


@dataclass(frozen=True)
class ConsistentSdp(Possible):
    """A semidefinite programme: every link's J positive definite and friction not negative.

    The pull is sum ((pi - pi_0) / unit)^2 / 2 (units mass, mass times radius of gyration, mass times its square), or,
    if it is entropic, per link tr(J J_0^-1) - log det(J J_0^-1) - 4, which does not depend on the frame and keeps off
    the edge of what is physical; other parameters are pulled the first way. The covariance (R^T R + gamma H)^-1, H the
    pull's Hessian, does not count the information of the constraints.

    Attributes:
        entropic: how links are pulled.

    Source: wensing2018, lee2020.
    """

    entropic: bool = False

    def bodies(
        self, matrix: np.ndarray, torque: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
        """By cvxpy; raises ``GapscopeError`` if the solver finds no solution."""
        links, masses = self.links, self.prior[: 10 * self.links : 10]
        powers = np.repeat([0, 1, 2], [1, 3, 6])
        units = self.units(masses[:, None] * self.radius**powers)
        pulls = np.full(len(units), np.sqrt(self.weight))
        if self.entropic:
            pulls[: 10 * links] = 0.0
        left = torque - matrix @ self.prior
        value = possible_least_squares(
            np.vstack([matrix * units, np.diag(pulls)]),
            np.append(left, np.zeros(len(units))),
            units,
            self.prior,
            links,
            not_negative(self.base.names),
            self.weight if self.entropic else 0.0,
        )
        precision = matrix.T @ matrix + np.diag((pulls / units) ** 2)
        if self.entropic:
            for link in range(links):
                own = slice(10 * link, 10 * link + 10)
                # second derivative of -log det J: tr(J^-1 B_k J^-1 B_l)
                turned = np.linalg.inv(pseudo_inertia(value[own])) @ BASIS
                curvature = np.einsum("kab,lba->kl", turned, turned)
                precision[own, own] += self.weight * curvature
        scale = 1 / np.sqrt(np.diag(precision))
        outer = np.outer(scale, scale)
        inverse = np.linalg.pinv(precision * outer, hermitian=True) * outer
        return value, inverse, ()
