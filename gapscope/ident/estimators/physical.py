"""Estimators of arms that can exist: log-Cholesky coordinates, and a convex programme over pseudo-inertias."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from gapscope.arm.dynamics.inertials import (
    BASIS,
    from_log_cholesky,
    log_cholesky_jacobian,
    pseudo_inertia,
    to_log_cholesky,
)
from gapscope.arm.errors import InputError
from gapscope.arm.root_mean_square import rms
from gapscope.ident.estimators.linear import (
    MIN_NOISE,
    Estimate,
    finished,
    free_fit,
    joint_noise,
    whitened,
)
from gapscope.ident.model.base_parameters import BaseParameters, Factor
from gapscope.ident.model.physical_parameters import (
    check_links,
    inconsistent,
    link_count,
    not_negative,
    possible_least_squares,
)
from gapscope.ident.samples import Problem, check_samples, unit_warnings


class Bodies(Protocol):
    """Bodies that can exist near those of a prior: ``log_cholesky`` or ``semidefinite``."""

    def __call__(
        self,
        matrix: np.ndarray,
        torque: np.ndarray,
        prior: np.ndarray,
        names: Sequence[str],
    ) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
        """Pi, (p,), its covariance, (p, p), and warnings, by white equations of shape (M, p) and (M,).

        Minimises |z - A pi|^2 / 2 + pull(pi), which counts as an equation. ``prior`` is pi_0, (p,), and
        ``names`` are those of pi: the first ten parameters of each link, then others.
        """


def possible_arm(
    problem: Problem, prior: np.ndarray, base: BaseParameters, bodies: Bodies
) -> Estimate:
    """Base parameters beta = C pi of bodies pi that can exist, near those of a prior.

    Args:
        problem: the equations of these base parameters, which are whitened per joint.
        prior: pi_0, shape (p,), of bodies that can exist; first ten parameters of each link.
        base: C, shape (b, p).
        bodies: how pi is found.

    Raises:
        InputError: samples are not finite, the arm rests, or a body of the prior cannot exist.
        GapscopeError: the solver finds no solution.
    """
    check_samples(problem, full_rank=False)
    if wrong := inconsistent(check_links(prior[: 10 * link_count(base.names)])):
        raise InputError(
            f"the prior of link {wrong[0].link} is no physical body",
            "correct mass, centre of mass and inertia in the URDF, or use an estimator without bodies",
            where="prior",
        )
    C = base.combination
    least = MIN_NOISE * float(rms(problem.torque, axis=None))
    noise = np.maximum(joint_noise(problem, free_fit(problem, C @ prior)), least)
    factor = Factor.of(*whitened(problem, noise))
    value, covariance, warnings = bodies(
        factor.triangle @ C, factor.rotated, prior, base.names
    )
    doubts = unit_warnings(problem, C @ prior) + warnings
    return finished(problem, C @ value, C @ covariance @ C.T, *doubts)


def _units(prior: np.ndarray, of_links: np.ndarray) -> np.ndarray:
    """What counts as a change of one: given for the links, (L, 10); of the others their size, shape (p,)."""
    others = np.abs(prior[of_links.size :])
    return np.append(of_links.ravel(), np.where(others > 0, others, 1.0))


def _radius(links: np.ndarray) -> np.ndarray:
    """Radius of gyration of each of L links, (L, 10): the mean second moment over the mass [m], shape (L, 1)."""
    second = np.trace(pseudo_inertia(links)[:, :3, :3], axis1=1, axis2=2)
    return np.sqrt(second / 3 / links[:, 0])[:, None]


# Physically consistent least squares without constraints, over the links' log-Cholesky coordinates.


def log_cholesky(
    matrix: np.ndarray,
    torque: np.ndarray,
    prior: np.ndarray,
    names: Sequence[str],
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Gauss-Newton in a trust region over theta, with the pull |(theta - theta_0) / unit|^2 / 2; see ``Bodies``.

    Every theta is a physical body, see ``gapscope.arm.dynamics.inertials.to_log_cholesky``; other parameters
    stay as they are, those of friction and rotors at 0 or above. theta_0 is that of the prior, where the search
    starts too. Its units are 1 for the logarithms and the radius of gyration for the lengths. The covariance is that
    of the linearisation, P (J^T J + U^-2)^-1 P^T with P = d pi / d theta.

    Source: rucker2022.
    """
    end = 10 * link_count(names)
    links, others = prior[:end].reshape(-1, 10), prior[end:]
    centre = np.append(to_log_cholesky(links), others)
    # the first four coordinates are logarithms, the other six lengths
    units = _units(prior, _radius(links) ** np.repeat([0, 1], [4, 6]))
    pull = 1 / units
    lower = np.full(len(centre), -np.inf)
    lower[not_negative(names)] = 0.0

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
    warnings = () if found.status else (f"the search had not ended: {found.message}",)
    return parameters(found.x), free @ free.T, warnings


# Physically consistent least squares as a convex programme over the links' pseudo-inertias.


def semidefinite(
    matrix: np.ndarray,
    torque: np.ndarray,
    prior: np.ndarray,
    names: Sequence[str],
    entropic: bool = False,
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """A semidefinite programme: every link's J positive definite and friction not negative; see ``Bodies``.

    The pull is sum ((pi - pi_0) / unit)^2 / 2 (units mass, mass times radius of gyration, mass times its square), or,
    if it is entropic, per link tr(J J_0^-1) - log det(J J_0^-1) - 4, which does not depend on the frame and keeps off
    the edge of what is physical; other parameters are pulled the first way. The covariance (R^T R + H)^-1, H the
    pull's Hessian, does not count the information of the constraints.

    Raises:
        GapscopeError: the solver finds no solution.

    Source: wensing2018, lee2020.
    """
    count = link_count(names)
    links = prior[: 10 * count].reshape(-1, 10)
    powers = np.repeat([0, 1, 2], [1, 3, 6])
    units = _units(prior, links[:, :1] * _radius(links) ** powers)
    pulls = np.ones(len(units))
    if entropic:
        pulls[: links.size] = 0.0
    value = possible_least_squares(
        np.vstack([matrix * units, np.diag(pulls)]),
        np.append(torque - matrix @ prior, np.zeros(len(units))),
        units,
        prior,
        names,
        float(entropic),
    )
    precision = matrix.T @ matrix + np.diag((pulls / units) ** 2)
    if entropic:
        for link in range(count):
            own = slice(10 * link, 10 * link + 10)
            # second derivative of -log det J: tr(J^-1 B_k J^-1 B_l)
            turned = np.linalg.inv(pseudo_inertia(value[own])) @ BASIS
            curvature = np.einsum("kab,lba->kl", turned, turned)
            precision[own, own] += curvature
    scale = 1 / np.sqrt(np.diag(precision))
    outer = np.outer(scale, scale)
    inverse = np.linalg.pinv(precision * outer, hermitian=True) * outer
    return value, inverse, ()
