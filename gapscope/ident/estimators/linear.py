"""Estimators of linear equations: plain, weighted, robust, regularised, total least squares, near the nominal arm."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.linalg import solve, solve_triangular

from gapscope.arm.errors import InputError
from gapscope.arm.root_mean_square import rms
from gapscope.ident.model.base_parameters import TINY, WORTH, Factor
from gapscope.ident.model.friction import FOLDS, stretches
from gapscope.ident.model.linear_problem import (
    Problem,
    check_rank,
    check_samples,
    unit_warnings,
)
from gapscope.model.effective_samples import group_slices, variance_inflation

# The result of an estimator, and its interface.


@dataclass(frozen=True)
class Estimate:
    """Estimated parameters.

    Attributes:
        names: of the parameters, shape (b,).
        value: shape (b,).
        covariance: as the estimator itself states it, shape (b, b).
        residual: RMS residual per joint [N m], shape (n,).
        warnings: what makes the result doubtful, each a sentence with a remedy.
        freedom: degrees of freedom of the covariance; ``None`` for those of white noise.
    """

    names: Sequence[str]
    value: np.ndarray
    covariance: np.ndarray
    residual: np.ndarray
    warnings: tuple[str, ...] = ()
    freedom: float | None = None

    @property
    def deviation(self) -> np.ndarray:
        """Standard errors, shape (b,)."""
        return np.sqrt(np.diag(self.covariance).clip(0.0))


class Estimator(Protocol):
    """An estimator of the parameters of a linear problem."""

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate the parameters; raises ``InputError`` if the samples cannot determine them."""


# What the linear estimators share: noise, scales, and the estimate that follows.


ROUNDS = 100
"""Most rounds of estimating noise, or weights, and parameters in turn."""
SETTLED = 1e-6
"""They end before if parameters move by this share of their deviations, or the torque by this of its size [1]."""


def whitened(problem: Problem, spread: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stacked equations divided by each joint's noise [N m], shape (n,): W of shape (N n, b), tau of shape (N n,)."""
    matrix = problem.matrix / spread[:, None]
    torque = problem.torque / spread
    return matrix.reshape(-1, matrix.shape[2]), torque.ravel()


def joint_noise(problem: Problem, beta: np.ndarray) -> np.ndarray:
    """Standard deviation of the residual per joint [N m], shape (n,): parameters counted, and nowhere zero."""
    residual = problem.residual(beta)
    free = max(1.0 - len(beta) / residual.size, 1.0 / residual.size)
    noise = np.sqrt((residual**2).mean(axis=0) / free)
    # an exact fit has no noise, but weights must be finite
    return least_noise(noise, float(np.abs(problem.torque).max(initial=0.0)))


def least_noise(noise: np.ndarray, largest_torque: float) -> np.ndarray:
    """Noise of the joints [N m], (n,), of which none is zero."""
    least = max(1e-12 * largest_torque, 1e-6 * float(noise.max(initial=0)), TINY)
    return np.maximum(noise, least)


def free_fit(
    problem: Problem, prior: np.ndarray, unit: np.ndarray | None = None
) -> np.ndarray:
    """The least-squares estimate, shape (b,); the nearest to a prior, in the columns' units by default."""
    matrix, torque = problem.stacked()
    unit = 1 / column_norms(matrix) if unit is None else unit
    factor = Factor.of(matrix * unit, torque - matrix @ prior)
    step = np.linalg.lstsq(factor.triangle, factor.rotated, rcond=1e-9)[0]
    return prior + unit * step


def column_norms(matrix: np.ndarray) -> np.ndarray:
    """Norms of columns to divide by, shape (b,); 1 for a column of zeros."""
    norms = np.linalg.norm(matrix, axis=0)
    return np.where(norms > 0, norms, 1.0)


def finished(
    problem: Problem,
    beta: np.ndarray,
    covariance: np.ndarray,
    warnings: tuple[str, ...] = (),
) -> Estimate:
    """The estimate with what it leaves per joint."""
    residual = rms(problem.residual(beta))
    return Estimate(
        names=tuple(problem.names),
        value=beta,
        covariance=covariance,
        residual=residual,
        warnings=warnings,
    )


# Equations of each joint as a triangle: all that least squares with any weights of the joints need of them.


@dataclass(frozen=True)
class JointTriangles:
    """Equations W_j beta = tau_j of n joints, rotated: |tau_j - W_j beta|^2 = |z_j - R_j beta|^2 for any beta.

    Joined part by part they are those of a recording of any length, in memory that does not grow.

    Attributes:
        names: of the parameters, (b,).
        factors: R_j, z_j of each joint.

    Source: demmel2012.
    """

    names: tuple[str, ...]
    factors: tuple[Factor, ...]

    @classmethod
    def of(cls, problem: Problem) -> JointTriangles:
        """Those of a problem."""
        joints = zip(problem.matrix.swapaxes(0, 1), problem.torque.T, strict=True)
        return cls(tuple(problem.names), tuple(Factor.of(*joint) for joint in joints))

    @classmethod
    def joined(cls, parts: Iterable[JointTriangles]) -> JointTriangles:
        """Those of several problems of the same parameters together."""
        some = list(parts)
        joints = zip(*(part.factors for part in some), strict=True)
        return cls(some[0].names, tuple(Factor.together(own) for own in joints))

    @property
    def rows(self) -> np.ndarray:
        """R_j of all joints, one below the other."""
        return np.vstack([own.triangle for own in self.factors])

    def noise(self, beta: np.ndarray) -> np.ndarray:
        """As ``joint_noise``, (n,)."""
        squares = np.array([own.squares(beta) for own in self.factors])
        samples = self.factors[0].rows
        equations = samples * len(squares)
        free = max(1.0 - len(beta) / equations, 1.0 / equations)
        largest = max(float(np.abs(own.rotated).max()) for own in self.factors)
        return least_noise(np.sqrt(squares / samples / free), largest)

    def factor(self, noise: np.ndarray | None = None) -> Factor:
        """The factor of all equations, each joint's divided by its noise, (n,)."""
        spread = np.ones(len(self.factors)) if noise is None else noise
        pairs = zip(self.factors, spread, strict=True)
        return Factor.together([own.over(s) for own, s in pairs])


def checked_triangles(problem: Problem) -> JointTriangles:
    """Those of a problem that determines its parameters; raises ``InputError`` otherwise."""
    triangles = JointTriangles.of(problem)
    check_samples(problem, rows=triangles.rows)
    return triangles


# Weighted least squares with the noise of each joint.


@dataclass(frozen=True)
class WeightedLeastSquares:
    """Minimises sum_j |tau_j - W_j beta|^2 / s_j^2; covariance s^2 (sum_j W_j^T W_j / s_j^2)^-1.

    The noise s_j [N m] of joint j is what the fit before left of it, ordinary least squares at first; s^2 is the mean
    square of what is left, N n - b counted. That covariance holds for white noise and a model without error, which
    filtered recordings hardly ever meet; ``gapscope.ident.intervals`` has covariances that need less.

    Attributes:
        rounds: how often the noise is estimated anew; 0: ordinary least squares.

    Source: hollerbach2008, gautier2014.
    """

    rounds: int = 2

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate; raises ``InputError`` if the samples do not determine the parameters."""
        factor = self._factor(checked_triangles(problem))
        variance = factor.rest / factor.freedom
        return finished(problem, factor.solve(), variance * factor.inverse_gram())

    def value(self, triangles: JointTriangles) -> np.ndarray:
        """The estimate alone, (b,), of equations that are triangles already.

        Raises:
            InputError: they do not determine the parameters.
        """
        check_rank(triangles.rows, triangles.names)
        return self._factor(triangles).solve()

    def _factor(self, triangles: JointTriangles) -> Factor:
        """The factor of all equations by the last noise; that of ordinary least squares at first."""
        factor = triangles.factor()
        # noise and parameters in turns
        for _ in range(self.rounds):
            factor = triangles.factor(triangles.noise(factor.solve()))
        return factor


# Iteratively reweighted least squares with Huber's loss: outliers pull with bounded force.


NORMAL_MAD = 0.6745
"""Median absolute deviation of the standard normal distribution."""


@dataclass(frozen=True)
class HuberLeastSquares:
    """Minimises sum rho(e / s_j) with rho(u) = u^2 / 2 for |u| <= k, k |u| - k^2 / 2 beyond.

    s_j [N m] is the median absolute residual of joint j over 0.6745, estimated anew in each round. Covariance
    mean(psi^2) / mean(psi')^2 (W^T W)^-1 in units of s_j, with psi = rho'.

    Attributes:
        threshold: k [1]; 1.345 keeps 95 % of the efficiency under normal noise.
        start: beta of the first weights, such as the estimate of nearly the same samples, shape (b,); that of least
            squares if ``None``.

    Source: huber1981.
    """

    threshold: float = 1.345
    start: np.ndarray | None = None

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate; raises ``InputError`` if the samples do not determine the parameters."""
        triangles = checked_triangles(problem)
        factor, largest = triangles.factor(), float(np.abs(problem.torque).max())
        beta = factor.solve() if self.start is None else self.start
        # columns that are orthonormal before weights: their weighted sums of squares are well-conditioned
        square = solve_triangular(factor.triangle, np.eye(len(beta)))
        columns = (problem.matrix @ square).reshape(-1, len(beta))
        for _ in range(ROUNDS):
            scaled, spread = self._scaled(problem, beta)
            # weights min(1, k / |r|) at residuals r
            huber = self.threshold / np.maximum(np.abs(scaled), self.threshold)
            weighted = columns * (huber / spread**2).reshape(-1, 1)
            right = weighted.T @ problem.torque.ravel()
            following = square @ solve(weighted.T @ columns, right, assume_a="pos")
            moved = np.abs(problem.matrix @ (following - beta)).max()
            change = float(moved) / max(largest, TINY)
            beta = following
            if change < SETTLED:
                break
        warnings: tuple[str, ...] = ()
        if change >= SETTLED:
            warnings = (
                f"reweighting still moved the torque by {change:.1e} after {ROUNDS} rounds",
            )
        # Huber's asymptotic covariance: E[psi^2] / E[psi']^2 (W^T W)^-1 in units of each joint's spread
        scaled, spread = self._scaled(problem, beta)
        clipped = np.clip(scaled, -self.threshold, self.threshold)
        inside = np.mean(np.abs(scaled) <= self.threshold)
        variance = np.sum(clipped**2) / max(scaled.size - len(beta), 1) / inside**2
        inverse = triangles.factor(spread).inverse_gram()
        return finished(problem, beta, variance * inverse, warnings)

    def _scaled(
        self, problem: Problem, beta: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals over their joint's spread, (N, n), and the spread [N m], (n,)."""
        residual = problem.residual(beta)
        # the median is not moved by outliers
        spread = np.median(np.abs(residual), axis=0) / NORMAL_MAD
        spread = np.maximum(spread, 1e-9 * np.abs(problem.torque).max() + TINY)
        return residual / spread, spread


# Ridge regression, its strength chosen by held-out motions or the L-curve.


STRENGTHS = np.logspace(-12, 1, 131)
"""Strengths that are tried."""
PULLED = 0.9
"""Share of the directions that the data have to decide; of fewer a warning is given [1]."""
FLAT = 1e-12
"""Speed along the L-curve, to the third power, below which a curvature is rounding [1]."""


@dataclass(frozen=True)
class _Directions:
    """tau - W beta_0 along the singular directions of W D^-1, each joint's equations over its noise.

    These equations, beta_0, the norms D of W's columns, the factor of W D^-1, its singular values s, V^T, and U^T z.
    """

    weighted: Problem
    prior: np.ndarray
    norms: np.ndarray
    factor: Factor
    values: np.ndarray
    right: np.ndarray
    part: np.ndarray

    @classmethod
    def of(cls, problem: Problem, prior: np.ndarray | None) -> _Directions:
        """About a prior, zero if ``None``; raises ``InputError`` if samples are not finite or the arm rests."""
        check_samples(problem, full_rank=False)
        b = problem.matrix.shape[2]
        centre = np.zeros(b) if prior is None else np.array(prior, float)
        noise = joint_noise(problem, free_fit(problem, centre))
        weighted = replace(
            problem,
            matrix=problem.matrix / noise[:, None],
            torque=problem.torque / noise,
        )
        matrix, torque = weighted.stacked()
        norms = column_norms(matrix)
        factor = Factor.of(matrix / norms, torque - matrix @ centre)
        left, values, right = np.linalg.svd(factor.triangle)
        part = left.T @ factor.rotated
        return cls(weighted, centre, norms, factor, values, right, part)

    def estimate(
        self, problem: Problem, gain: np.ndarray, warnings: tuple[str, ...]
    ) -> Estimate:
        """beta = beta_0 + D^-1 sum_i g_i v_i u_i^T (tau - W beta_0), with what counts of each direction, s_i g_i."""
        decided = self.values * gain
        unexplained = (1 - decided) * self.part
        squares = self.factor.rest + float(unexplained @ unexplained)
        noise = squares / max(self.factor.rows - float(decided.sum()), 1.0)
        half = self.right.T * gain / self.norms[:, None]
        beta = self.prior + half @ self.part
        return finished(problem, beta, noise * half @ half.T, warnings)

    def strongest(self, filters: Callable[[np.ndarray], np.ndarray]) -> int:
        """The last of K pulls, the strongest, that predicts motions not fitted as well as the best within an error.

        Each motion is left out in turn: a recording, or, of fewer than three, a stretch of time. The standard error is
        that of the mean over parts of them. Other motions may show more than these: if they cannot tell, the prior is
        kept.

        Args:
            filters: factors 1 / (s_i^2 + ...) of K pulls along the singular directions, (K, b), from the squared
                singular values of W D^-1, (b,), ascending.

        Source: breiman1984.
        """
        problem = self.weighted
        parts = group_slices(problem.group)
        if len(parts) < 3:
            parts = stretches(problem.group)
        left = problem.torque - problem.matrix @ self.prior
        scaled = [problem.matrix / self.norms, left[..., None]]
        every = np.concatenate(scaled, axis=2)
        flat = [every[rows].reshape(-1, every.shape[2]) for rows in parts]
        grams = [rows.T @ rows for rows in flat]
        squares = []
        for rows, gram in zip(flat, grams, strict=True):
            others = np.sum(grams, axis=0) - gram
            values, vectors = np.linalg.eigh(others[:-1, :-1])
            part = vectors.T @ others[:-1, -1]
            change = (filters(np.maximum(values, 0.0)) * part) @ vectors.T
            residual2 = (rows[:, -1] - change @ rows[:, :-1].T) ** 2
            thirds = np.array_split(residual2, FOLDS, axis=1)
            squares += [part.mean(axis=1) for part in thirds]
        errors = np.array(squares)
        best = int(errors.mean(axis=0).argmin())
        worse = errors - errors[:, [best]]
        error = worse.std(axis=0, ddof=1) / np.sqrt(len(worse))
        return int(np.flatnonzero(worse.mean(axis=0) <= error).max())


@dataclass(frozen=True)
class Ridge:
    """Minimises |tau - W beta|^2 + lambda |D (beta - beta_0)|^2, D the norms of W's columns, each joint over its noise.

    With columns of unit norm lambda has no unit: it is compared with the squared singular values, of which none
    exceeds b. The covariance is that of the noise alone; what the pull adds as bias is not in it.

    Attributes:
        choice: ``motion`` (the strongest that predicts motions as well as any that were not fitted), ``l_curve`` (the
            sharpest corner of log |residual| against log |D (beta - beta_0)|), or lambda itself.
        prior: beta_0, shape (b,); zero if ``None``.

    Source: hansen1992.
    """

    choice: str | float = "motion"
    prior: np.ndarray | None = None

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate; raises ``InputError`` if the samples are not finite or the arm rests."""
        found = _Directions.of(problem, self.prior)
        # along each singular direction the prior weighs as much as the data at values**2 = strength
        if self.choice == "motion":
            chosen = found.strongest(lambda own: 1 / (own + STRENGTHS[:, None]))
            strength = float(STRENGTHS[chosen])
        elif self.choice == "l_curve":
            strength = _at_corner(found)
        else:
            strength = float(self.choice)
        gain = found.values / np.maximum(found.values**2 + strength, TINY)
        b, effective = len(gain), float((found.values * gain).sum())
        warnings: tuple[str, ...] = ()
        if effective <= PULLED * b:
            warnings = (
                f"the pull holds {b - effective:.1f} of {b} directions; their stated deviation leaves "
                "out the bias that this adds; record a trajectory that excites them",
            )
        return found.estimate(problem, gain, warnings)


def _at_corner(found: _Directions) -> float:
    """The strength at the largest curvature of the L-curve."""
    values = found.values
    # rows: strengths; columns: directions
    pulled = STRENGTHS[:, None] / (values**2 + STRENGTHS[:, None])
    residual = ((pulled * found.part) ** 2).sum(axis=1) + found.factor.rest
    solution = (1 - pulled) * found.part / np.maximum(values, TINY)
    x, y = (0.5 * np.log(z + TINY) for z in (residual, (solution**2).sum(axis=1)))
    dx, dy = np.gradient(x), np.gradient(y)
    cross = dx * np.gradient(dy) - dy * np.gradient(dx)
    curvature = cross / np.maximum((dx**2 + dy**2) ** 1.5, FLAT)
    # the differences at the ends are one-sided
    corner = int(np.argmax(curvature[2:-2]) + 2)
    # a corner at which the fit is much worse is none
    last_good = int((residual <= (1 + WORTH) * residual[0]).sum()) - 1
    return float(STRENGTHS[min(corner, last_good)])


# Truncated singular value decomposition: directions that the samples hardly excite stay at the prior.


@dataclass(frozen=True)
class TruncatedSvd:
    """beta = beta_0 + D^-1 sum_{i <= k} v_i u_i^T (tau - W beta_0) / s_i, with W D^-1 = U S V^T of unit columns.

    Each joint's equations are divided by its noise.

    Attributes:
        prior: beta_0, shape (b,); zero if ``None``.
        count: k itself; ``None``: the least that predicts motions as well as any that were not fitted.

    Source: hansen1987.
    """

    prior: np.ndarray | None = None
    count: int | None = None

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate; raises ``InputError`` if the samples are not finite or the arm rests."""
        found = _Directions.of(problem, self.prior)
        b = len(found.values)
        # squared singular values ascend: the last k are kept
        kept = np.arange(b)[::-1] < np.arange(b, -1, -1)[:, None]

        def filters(values: np.ndarray) -> np.ndarray:
            regular = kept & (values > 1e-13 * values[-1])
            return np.where(regular, 1 / np.maximum(values, TINY), 0.0)

        rank = b - found.strongest(filters) if self.count is None else self.count
        warnings: tuple[str, ...] = ()
        if rank < b:
            warnings = (
                f"{b - rank} of {b} directions were dropped and stay at the prior; their deviation is not stated; "
                "record a trajectory that excites them",
            )
        gain = np.where(np.arange(b) < rank, 1 / np.maximum(found.values, TINY), 0.0)
        return found.estimate(problem, gain, warnings)


# Total least squares: the regressor has errors too, since velocity and acceleration come from noisy positions.


UNTOLD = 1e-8
"""Least share of the torque in the direction with the least error [1]."""


@dataclass(frozen=True)
class TotalLeastSquares:
    """Minimises |[dW D^-1, dtau / s]|_F^2 with (W + dW) beta = tau + dtau, by the least right singular vector.

    D and s are the RMS of the columns and of the torque: the answer is consistent if rows have independent errors of
    these relative sizes, and only as good as that assumption. Covariance s^2 (1 + |x|^2) (A^T A - M s^2 I)^-1 in
    scaled columns.

    Source: vanhuffel1991.
    """

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate; raises ``InputError`` if the samples do not determine the parameters."""
        check_samples(problem)
        equations = np.column_stack(problem.stacked())
        b, scale = equations.shape[1] - 1, rms(equations)
        triangle = np.asarray(np.linalg.qr(equations / scale, mode="r"))
        values, right = np.linalg.svd(triangle)[1:]
        # the solution divides by the last component
        if abs(right[-1, -1]) < UNTOLD:
            raise InputError(
                "no total least squares solution: the direction with the least error does not involve the torque. "
                "Either (a) columns nearly depend on each other, or (b) the torque does not follow from the motion",
                "use base parameters, or ordinary least squares",
                where="matrix",
            )
        x = -right[-1, :-1] / right[-1, -1]
        # the noise of the columns adds to their squares
        gram = triangle[:, :-1].T @ triangle[:, :-1]
        noise2 = values[-1] ** 2
        inverse = np.linalg.pinv(gram - noise2 * (1 - 1e-9) * np.eye(b), hermitian=True)
        variance = noise2 / max(len(equations) - b, 1)
        unit = scale[-1] / scale[:-1]
        covariance = variance * (1 + x @ x) * inverse * np.outer(unit, unit)
        return finished(problem, x * unit, covariance)


# Maximum likelihood with a noise covariance across the joints, estimated along with the parameters.


@dataclass(frozen=True)
class MaximumLikelihood:
    """Maximises the likelihood of normal noise with covariance Sigma [N m]^2, shape (n, n), over beta and Sigma.

    Alternates beta = (sum_i W_i^T Sigma^-1 W_i)^-1 sum_i W_i^T Sigma^-1 tau_i and Sigma = mean of e_i e_i^T, which
    raises the likelihood in each round. Covariance (sum_i W_i^T Sigma^-1 W_i)^-1.

    Raises:
        InputError: fewer samples than joints leave Sigma without an inverse.

    Source: swevers2007.
    """

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate; raises ``InputError`` if the samples do not determine the parameters."""
        beta = WeightedLeastSquares(rounds=0).estimate(problem).value
        if len(problem.torque) <= problem.n_joints:
            raise InputError(
                f"{len(problem.torque)} samples cannot give the noise of {problem.n_joints} joints and how it "
                "correlates",
                "record for longer, or use ordinary least squares",
                where="samples",
            )
        for _ in range(ROUNDS):
            # L^-1 W_i and L^-1 tau_i have white noise if L L^T = Sigma
            root = np.linalg.cholesky(self.noise(problem, beta))
            inverse = solve_triangular(root, np.eye(len(root)), lower=True)
            matrix = (inverse @ problem.matrix).reshape(-1, len(beta))
            factor = Factor.of(matrix, (problem.torque @ inverse.T).ravel())
            following = factor.solve()
            covariance = factor.rest / factor.freedom * factor.inverse_gram()
            errors = np.sqrt(np.diag(covariance)) + TINY
            change = float(np.max(np.abs(following - beta) / errors))
            beta = following
            if change < SETTLED:
                break
        warnings: tuple[str, ...] = ()
        if change >= SETTLED:
            warnings = (
                f"parameters still moved by {change:.2g} standard errors after {ROUNDS} rounds",
            )
        return finished(problem, beta, covariance, warnings)

    @staticmethod
    def noise(problem: Problem, beta: np.ndarray) -> np.ndarray:
        """Covariance Sigma of the residual [N m]^2, shape (n, n); kept regular."""
        residual = problem.residual(beta)
        noise = residual.T @ residual / len(residual)
        power = 1e-24 * float((problem.torque**2).sum())
        floor = 1e-12 * max(float(np.trace(noise)), power) + TINY
        return noise + floor * np.eye(len(noise))


# Partial update: from a prior, such as the simulated arm's, only the parameters move that the data determine.


RELATIVE = 0.2
"""How far an inertial parameter of a simulated arm is believed to be off, relative to its value [1]."""
FRICTION_RELATIVE = 1.0
"""The same of friction, which differs from arm to arm [1]."""
SLIGHT = 0.05
"""And a parameter near 0 by what gives this share of the torque's RMS [1]."""
START_NOISE = 0.01
"""Noise taken at first beside what a free fit leaves, over the torque's RMS: few samples leave a free fit nothing."""
INFLUENCE = 2.0
"""Least ratio of variances of a parameter that moves [1]."""


@dataclass(frozen=True)
class PartialUpdate:
    """The most probable beta under a prior N(beta_0, diag(spread^2)), with the parameters held that data hardly move.

    The prior is believed to be off by ``RELATIVE`` of |beta_0| (friction and offsets: ``FRICTION_RELATIVE``), and
    nowhere by less than what gives ``SLIGHT`` of the torque.

    A parameter is influential if the data determine it at least as well as the prior does: its prior variance is at
    least ``INFLUENCE`` times the variance that data and prior together leave. The others are held at beta_0 and the
    rest is estimated anew. Noise per joint is that of the residual; its autocorrelation rho_k inflates the variance by
    1 + 2 sum_k rho_k. The covariance is the posterior one; a parameter that is
    held keeps its prior variance.

    Attributes:
        prior: beta_0, shape (b,).

    Source: pham1991.
    """

    prior: np.ndarray

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate; raises ``InputError`` if samples are not finite or the arm rests."""
        check_samples(problem, full_rank=False)
        prior = np.asarray(self.prior, dtype=float)
        spread = prior_spread(problem, prior)
        free = joint_noise(problem, free_fit(problem, prior, spread))
        noise = np.hypot(free, START_NOISE * rms(problem.torque).max())
        beta = np.full(len(prior), np.inf)
        for _ in range(ROUNDS):
            before = beta
            beta, covariance = _posterior(problem, prior, spread, noise)
            if np.abs((beta - before) / spread).max() < SETTLED:
                break
            inflation = variance_inflation(problem.residual(beta), problem.group)
            noise = joint_noise(problem, beta) * np.sqrt(inflation)
        warnings = unit_warnings(problem, prior)
        if np.array_equal(beta, prior):
            warnings += (
                "the data move no parameter: too little motion, or a prior that is already as good",
            )
        return finished(problem, beta, covariance, warnings)

    def moved(self, estimate: Estimate) -> np.ndarray:
        """Which parameters an estimate of this prior moved, shape (b,)."""
        return estimate.value != np.asarray(self.prior, dtype=float)


def _posterior(
    problem: Problem, prior: np.ndarray, spread: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Posterior mean and covariance under a noise per joint [N m], shape (n,)."""
    factor = Factor.of(*whitened(problem, noise))
    gap = factor.rotated - factor.triangle @ prior
    # in units of the prior's deviation the prior precision is the identity
    triangle = factor.triangle * spread
    precision = triangle.T @ triangle + np.eye(len(prior))
    moved = np.diag(np.linalg.inv(precision)) * INFLUENCE <= 1.0
    # parameters that the data hardly determine stay at the prior, exactly
    own = np.linalg.inv(precision[np.ix_(moved, moved)])
    step, covariance = np.zeros(len(prior)), np.eye(len(prior))
    step[moved] = own @ (triangle[:, moved].T @ gap)
    covariance[np.ix_(moved, moved)] = own
    return prior + spread * step, covariance * np.outer(spread, spread)


def prior_spread(problem: Problem, prior: np.ndarray) -> np.ndarray:
    """Prior standard deviation of a simulated arm's parameters, shape (b,)."""
    friction = [re.fullmatch(r"[bco]\d+", name) is not None for name in problem.names]
    relative = np.where(friction, FRICTION_RELATIVE, RELATIVE)
    column_rms = rms(problem.matrix, axis=(0, 1))
    least_rms = 1e-6 * float(column_rms.max()) + TINY
    # a parameter that is zero in the prior may still add this share of the torque
    torque_rms = SLIGHT * rms(problem.torque, axis=None)
    slight = torque_rms / np.maximum(column_rms, least_rms)
    return np.maximum(relative * np.abs(prior), slight)
