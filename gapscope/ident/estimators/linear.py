"""Estimators of linear equations: plain, weighted, robust, regularised, total least squares, near the nominal arm."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from scipy.linalg import solve, solve_triangular

from gapscope.arm.errors import InputError
from gapscope.arm.root_mean_square import rms
from gapscope.ident.model.base_parameters import Factor
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


# What the linear estimators share: noise, scales, held-out motions, and the estimate that follows.


def strongest_by_motion(
    problem: Problem,
    prior: np.ndarray,
    norms: np.ndarray,
    filters: Callable[[np.ndarray], np.ndarray],
) -> int:
    """The last of K pulls, the strongest, that predicts motions not fitted as well as the best within a standard error.

    Each motion is left out in turn: a recording, or, of fewer than three, a stretch of time. The error is that of the
    mean over parts of them. Other motions may show more than these: if they cannot tell, the prior is kept.

    Args:
        problem: to be solved.
        prior: beta_0, shape (b,).
        norms: D, shape (b,).
        filters: factors 1 / (s_i^2 + ...) of K pulls along the singular directions, (K, b), from the squared singular
            values of W D^-1, (b,), ascending.

    Source: breiman1984.
    """
    parts = group_slices(problem.group)
    if len(parts) < 3:
        parts = stretches(problem.group)
    left = problem.torque - problem.matrix @ prior
    scaled = np.concatenate([problem.matrix / norms, left[..., None]], axis=2)
    flat = [scaled[rows].reshape(-1, scaled.shape[2]) for rows in parts]
    grams = [rows.T @ rows for rows in flat]
    squares = []
    for rows, gram in zip(flat, grams, strict=True):
        others = np.sum(grams, axis=0) - gram
        values, vectors = np.linalg.eigh(others[:-1, :-1])
        part = vectors.T @ others[:-1, -1]
        change = (filters(np.maximum(values, 0.0)) * part) @ vectors.T
        residual2 = (rows[:, -1] - change @ rows[:, :-1].T) ** 2
        parts_of_it = np.array_split(residual2, FOLDS, axis=1)
        squares += [part.mean(axis=1) for part in parts_of_it]
    every = np.array(squares)
    best = int(every.mean(axis=0).argmin())
    worse = every - every[:, best : best + 1]
    error = worse.std(axis=0, ddof=1) / np.sqrt(len(worse))
    return int(np.flatnonzero(worse.mean(axis=0) <= error).max())


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
    least = max(1e-12 * max(largest_torque, 1e-300), 1e-6 * float(noise.max(initial=0)))
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
        rows: [R_j, z_j] of each joint, b + 1 rows at most, b + 1 columns.
        samples: N, equations of each joint.

    Source: demmel2012.
    """

    names: tuple[str, ...]
    rows: tuple[np.ndarray, ...]
    samples: int

    @classmethod
    def of(cls, problem: Problem) -> JointTriangles:
        """Those of a problem."""
        joints = range(problem.n_joints)
        rows = tuple(
            _triangle(problem.matrix[:, j], problem.torque[:, j]) for j in joints
        )
        return cls(tuple(problem.names), rows, len(problem.torque))

    @classmethod
    def joined(cls, parts: Iterable[JointTriangles]) -> JointTriangles:
        """Those of several problems of the same parameters together."""
        some = list(parts)
        stacked = map(np.vstack, zip(*(part.rows for part in some), strict=True))
        rows = tuple(_triangle(own[:, :-1], own[:, -1]) for own in stacked)
        return cls(some[0].names, rows, sum(part.samples for part in some))

    @property
    def equations(self) -> int:
        """N n."""
        return self.samples * len(self.rows)

    def squares(self, beta: np.ndarray) -> np.ndarray:
        """|tau_j - W_j beta|^2 of each joint, (n,)."""
        z = np.append(-beta, 1.0)
        return np.array([float(np.sum((rows @ z) ** 2)) for rows in self.rows])

    def noise(self, beta: np.ndarray) -> np.ndarray:
        """As ``joint_noise``, (n,)."""
        torque = max(float(np.abs(rows[:, -1]).max(initial=0.0)) for rows in self.rows)
        free = max(1.0 - len(beta) / self.equations, 1.0 / self.equations)
        noise = np.sqrt(self.squares(beta) / self.samples / free)
        return least_noise(noise, torque)

    def stacked(self, noise: np.ndarray | None = None) -> np.ndarray:
        """[R, z] of all joints one below the other, each divided by its noise, (n,), if that is given."""
        spread = np.ones(len(self.rows)) if noise is None else noise
        return np.vstack([x / s for x, s in zip(self.rows, spread, strict=True)])

    def factor(self, noise: np.ndarray | None = None) -> Factor:
        """The factor of all equations, each joint's divided by its noise, (n,)."""
        stacked = self.stacked(noise)
        factor = Factor.of(stacked[:, :-1], stacked[:, -1])
        return replace(factor, rows=self.equations)


def _triangle(matrix: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """R of rows [W, tau]; half of a joint's columns are zero, as its torque has nothing of the bodies before it."""
    present = np.append(matrix.any(axis=0), True)
    equations = np.column_stack([matrix[:, present[:-1]], torque])
    some = np.linalg.qr(equations, mode="r")
    out = np.zeros((len(some), len(present)))
    out[:, present] = some
    return out


# Ordinary least squares.


@dataclass(frozen=True)
class OrdinaryLeastSquares:
    """Minimises |tau - W beta|^2; covariance s^2 (W^T W)^-1 with s^2 = |tau - W beta|^2 / (N n - b).

    That covariance holds for white noise of one size on all joints and a model without error, which filtered
    recordings hardly ever meet; ``gapscope.ident.intervals`` has covariances that need less. Source:
    hollerbach2008.
    """

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate; raises ``InputError`` if the samples do not determine the parameters."""
        triangles = JointTriangles.of(problem)
        check_samples(problem, rows=triangles.stacked()[:, :-1])
        factor = triangles.factor()
        return finished(
            problem,
            factor.solve(),
            factor.rest / factor.freedom * factor.inverse_gram(),
        )


# Weighted least squares with the noise of each joint.


@dataclass(frozen=True)
class WeightedLeastSquares:
    """Minimises sum_j |tau_j - W_j beta|^2 / s_j^2; covariance (sum_j W_j^T W_j / s_j^2)^-1.

    The noise s_j [N m] of joint j is what the fit before left of it, ordinary least squares at first.

    Attributes:
        rounds: how often the noise is estimated anew.

    Source: gautier2014.
    """

    rounds: int = 2

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate; raises ``InputError`` if the samples do not determine the parameters."""
        triangles = JointTriangles.of(problem)
        check_samples(problem, rows=triangles.stacked()[:, :-1])
        factor = self._factor(triangles)
        variance = factor.rest / factor.freedom
        return finished(problem, factor.solve(), variance * factor.inverse_gram())

    def value(self, triangles: JointTriangles) -> np.ndarray:
        """The estimate alone, (b,), of equations that are triangles already.

        Raises:
            InputError: they do not determine the parameters.
        """
        check_rank(triangles.stacked()[:, :-1], triangles.names)
        return self._factor(triangles).solve()

    def _factor(self, triangles: JointTriangles) -> Factor:
        """The factor of all equations by the last noise; that of ordinary least squares at first."""
        factor = triangles.factor()
        # noise and parameters in turns
        for _ in range(self.rounds):
            factor = triangles.factor(triangles.noise(factor.solve()))
        return factor


# Iteratively reweighted least squares with Huber's loss: outliers pull with bounded force.


REWEIGHTINGS = 50
"""Most rounds; they end before if the fitted torque hardly moves."""
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
        triangles = JointTriangles.of(problem)
        check_samples(problem, rows=triangles.stacked()[:, :-1])
        factor = triangles.factor()
        beta = factor.solve() if self.start is None else self.start
        largest = float(np.abs(problem.torque).max())
        # columns that are orthonormal before weights: their weighted sums of squares are well-conditioned
        triangle = factor.triangle
        square = solve_triangular(triangle, np.eye(len(triangle)))
        columns = problem.matrix @ square
        change = np.inf
        for _ in range(REWEIGHTINGS):
            following = square @ self._reweighted(problem, columns, beta, largest)
            moved = float(np.abs(problem.matrix @ (following - beta)).max())
            change = moved / max(largest, 1e-300)
            beta = following
            if change < 1e-8:
                break
        warnings: tuple[str, ...] = ()
        if change > 1e-3:
            warnings = (
                f"reweighting still moved the torque by {change:.1e} after {REWEIGHTINGS} rounds",
            )
        covariance = self._covariance(problem, triangles, beta, largest)
        return finished(problem, beta, covariance, warnings)

    def _reweighted(
        self,
        problem: Problem,
        columns: np.ndarray,
        beta: np.ndarray,
        largest: float,
    ) -> np.ndarray:
        """Coordinates in other columns (N, n, b) of the fit with Huber's weights min(1, k / |r|) at residuals r."""
        scaled, spread = self._scaled(problem, beta, largest)
        huber = self.threshold / np.maximum(np.abs(scaled), self.threshold)
        weight = huber / spread**2
        flat = columns.reshape(-1, len(beta))
        weighted = flat * weight.reshape(-1, 1)
        return solve(
            weighted.T @ flat, weighted.T @ problem.torque.ravel(), assume_a="pos"
        )

    def _scaled(
        self, problem: Problem, beta: np.ndarray, largest: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals over their joint's spread, (N, n), and the spread [N m], (n,)."""
        residual = problem.residual(beta)
        # the median is not moved by outliers
        spread = np.median(np.abs(residual), axis=0) / NORMAL_MAD
        spread = np.maximum(spread, 1e-9 * max(largest, 1e-300))
        return residual / spread, spread

    def _covariance(
        self,
        problem: Problem,
        triangles: JointTriangles,
        beta: np.ndarray,
        largest: float,
    ) -> np.ndarray:
        """Huber's asymptotic covariance: E[psi^2] / E[psi']^2 (W^T W)^-1 in units of each joint's spread."""
        scaled, spread = self._scaled(problem, beta, largest)
        clipped = np.clip(scaled, -self.threshold, self.threshold)
        inside = float(np.mean(np.abs(scaled) <= self.threshold))
        free = max(1.0 - len(beta) / scaled.size, 1e-3)
        variance = float((clipped**2).mean()) / free / max(inside, 1e-3) ** 2
        return variance * triangles.factor(spread).inverse_gram()


# Ridge regression, its strength chosen by held-out motions or the L-curve.


STRENGTHS = np.logspace(-12, 1, 131)
"""Strengths that are tried."""
WORSE = 1.02
"""The L-curve of a well-conditioned problem has no corner of its own: a strength that leaves more than this times the
least squared residual is not taken [1]."""


class _Directions(NamedTuple):
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


def _directions(problem: Problem, prior: np.ndarray | None) -> _Directions:
    """About a prior, zero if ``None``; raises ``InputError`` if samples are not finite or the arm rests."""
    check_samples(problem, full_rank=False)
    matrix = problem.stacked()[0]
    centre = np.zeros(matrix.shape[1]) if prior is None else np.array(prior, float)
    noise = joint_noise(problem, free_fit(problem, centre))
    weighted = replace(
        problem, matrix=problem.matrix / noise[:, None], torque=problem.torque / noise
    )
    matrix, torque = weighted.stacked()
    norms = column_norms(matrix)
    factor = Factor.of(matrix / norms, torque - matrix @ centre)
    left, values, right = np.linalg.svd(factor.triangle)
    part = left.T @ factor.rotated
    return _Directions(weighted, centre, norms, factor, values, right, part)


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
        weighted, prior, norms, factor, values, right, part = _directions(
            problem, self.prior
        )
        b = len(prior)
        # along each singular direction the prior weighs as much as the data at values**2 = strength
        if self.choice == "motion":
            chosen = strongest_by_motion(
                weighted, prior, norms, lambda own: 1 / (own + STRENGTHS[:, None])
            )
            strength = float(STRENGTHS[chosen])
        else:
            strength = self._strength(values, part, factor)
        gain = values / np.maximum(values**2 + strength, 1e-300)
        beta = prior + right.T @ (gain * part) / norms
        # share of each direction that the data decide
        decided = values * gain
        effective = float(decided.sum())
        unexplained = (1 - decided) * part
        squares = factor.rest + float(unexplained @ unexplained)
        noise = squares / max(factor.rows - effective, 1.0)
        half = right.T * gain / norms[:, None]
        warnings: tuple[str, ...] = ()
        if effective <= 0.9 * b:
            warnings = (
                f"the pull holds {b - effective:.1f} of {b} directions; their stated deviation leaves "
                "out the bias that this adds; record a trajectory that excites them",
            )
        return finished(problem, beta, noise * half @ half.T, warnings)

    def _strength(self, values: np.ndarray, part: np.ndarray, factor: Factor) -> float:
        """The strength that was given, or chosen among ``STRENGTHS``."""
        if not isinstance(self.choice, str):
            return float(self.choice)
        # rows: strengths; columns: directions
        pulled = STRENGTHS[:, None] / (values**2 + STRENGTHS[:, None])
        residual = ((pulled * part) ** 2).sum(axis=1) + factor.rest
        solution = (1 - pulled) * part / np.maximum(values, 1e-300)
        size = (solution**2).sum(axis=1)
        log_residual = 0.5 * np.log(np.maximum(residual, 1e-300))
        corner = _corner(log_residual, 0.5 * np.log(size + 1e-300))
        # a corner at which the fit is much worse is none
        last_good = int((residual <= WORSE * residual[0]).sum()) - 1
        return float(STRENGTHS[min(corner, last_good)])


def _corner(x: np.ndarray, y: np.ndarray) -> int:
    """Place of the largest curvature of a curve of evenly spaced strengths."""
    dx, dy = np.gradient(x), np.gradient(y)
    cross = dx * np.gradient(dy) - dy * np.gradient(dx)
    speed = (dx**2 + dy**2) ** 1.5
    curvature = cross / np.maximum(speed, 1e-12)
    # the differences at the ends are one-sided
    return int(np.argmax(curvature[2:-2]) + 2)


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
        weighted, prior, norms, factor, values, right, part = _directions(
            problem, self.prior
        )
        b = len(prior)
        # weak directions stay at the prior
        rank = self.count
        if rank is None:
            rank = _rank_by_motion(weighted, prior, norms)
        rank = min(rank, b)
        half = right[:rank].T / values[:rank] / norms[:, None]
        beta = prior + half @ part[:rank]
        square = factor.rest + float((part[rank:] ** 2).sum())
        noise = square / max(factor.rows - rank, 1)
        warnings: tuple[str, ...] = ()
        if rank < b:
            warnings = (
                f"{b - rank} of {b} directions were dropped and stay at the prior; their deviation is not stated; "
                "record a trajectory that excites them",
            )
        return finished(problem, beta, noise * half @ half.T, warnings)


def _rank_by_motion(problem: Problem, prior: np.ndarray, norms: np.ndarray) -> int:
    """The least number of directions, 0 to b, that predicts motions as well as any that were not fitted."""
    b = problem.matrix.shape[2]
    # squared singular values ascend: the last k are kept
    kept = np.arange(b)[::-1] < np.arange(b, -1, -1)[:, None]

    def filters(values: np.ndarray) -> np.ndarray:
        regular = kept & (values > 1e-13 * values[-1])
        return np.where(regular, 1 / np.maximum(values, 1e-300), 0.0)

    return b - strongest_by_motion(problem, prior, norms, filters)


# Total least squares: the regressor has errors too, since velocity and acceleration come from noisy positions.


@dataclass(frozen=True)
class TotalLeastSquares:
    """Minimises |[dW D^-1, dtau / s]|_F^2 with (W + dW) beta = tau + dtau, by the least right singular vector.

    D and s are the standard deviations of the errors in the columns and in the torque. Columns without error are
    eliminated first (mixed least squares and total least squares). The answer is consistent if rows have
    independent errors of these relative sizes; with the default, equal relative error of every column, it is only as
    good as that assumption.

    Attributes:
        column_noise: standard deviation of the errors of each column, shape (b,), 0 if it is exact; by default in
            proportion to the column's RMS.
        torque_noise: standard deviation of the torque's error in the same scale [N m]; by default in proportion to
            the torque's RMS.

    Covariance s^2 (1 + |x|^2) (A^T A - M s^2 I)^-1 in scaled columns. Source: vanhuffel1991.
    """

    column_noise: np.ndarray | None = None
    torque_noise: float | None = None

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate; raises ``InputError`` if the samples do not determine the parameters."""
        check_samples(problem)
        matrix, torque = problem.stacked()
        columns, scale = self._scales(matrix, torque)
        # columns without error come first: only the rest may be corrected
        exact = columns == 0
        order = np.argsort(~exact, kind="stable")
        first = int(exact.sum())
        unit = np.where(exact, 1.0, columns)
        equations = np.column_stack([(matrix / unit)[:, order], torque / scale])
        triangle = np.asarray(np.linalg.qr(equations, mode="r"))
        _, values, right = np.linalg.svd(triangle[first:, first:])
        least = right[-1]
        # the solution divides by this component
        if abs(least[-1]) < 1e-8:
            raise InputError(
                "no total least squares solution: the direction with the least error does not involve the torque. "
                "Either (a) columns nearly depend on each other, (b) the errors of the columns are set too large, or "
                "(c) the torque does not follow from the motion",
                "use base parameters, give column_noise, or use ordinary least squares",
                where="matrix",
            )
        scaled = np.zeros(len(order))
        scaled[first:] = -least[:-1] / least[-1]
        if first:
            corrected = triangle[:first, first:-1] @ scaled[first:]
            known = triangle[:first, -1] - corrected
            scaled[:first] = np.linalg.solve(triangle[:first, :first], known)
        ordered = _covariance(triangle, values[-1], scaled, first, len(torque))
        # back to the order and the units of the problem
        beta, covariance = np.empty(len(order)), np.empty_like(ordered)
        beta[order] = scaled
        covariance[np.ix_(order, order)] = ordered
        per_unit = np.outer(unit, unit) / scale**2
        return finished(problem, beta * scale / unit, covariance / per_unit)

    def _scales(
        self, matrix: np.ndarray, torque: np.ndarray
    ) -> tuple[np.ndarray, float]:
        columns, noise = rms(matrix), rms(torque)
        if self.torque_noise is not None:
            noise = np.array(self.torque_noise)
        if self.column_noise is not None:
            columns = np.asarray(self.column_noise, dtype=float)
        wrong = columns.shape != matrix.shape[1:] or (columns < 0).any()
        if wrong or not columns.any():
            raise InputError(
                f"expected {matrix.shape[1]} standard deviations from 0 on, not all 0",
                where="column_noise",
            )
        return columns, float(noise)


def _covariance(
    triangle: np.ndarray, least: float, scaled: np.ndarray, first: int, rows: int
) -> np.ndarray:
    """Covariance in scaled columns, those without error first; shape (b, b)."""
    gram = triangle[:, :-1].T @ triangle[:, :-1]
    noisy = np.arange(len(gram)) >= first
    variance = least**2 / max(rows - len(gram), 1)
    # the noise of the columns adds to their squares
    bias = least**2 * np.diag(noisy.astype(float)) * (1 - 1e-9)
    inverse = np.linalg.pinv(gram - bias, hermitian=True)
    return variance * (1 + scaled[noisy] @ scaled[noisy]) * inverse


# Maximum likelihood with a noise covariance across the joints, estimated along with the parameters.


ALTERNATIONS = 100
"""Most rounds; they end before if beta moves by less than a ten thousandth of its standard errors."""


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
        beta = OrdinaryLeastSquares().estimate(problem).value
        if len(problem.torque) <= problem.n_joints:
            raise InputError(
                f"{len(problem.torque)} samples cannot give the noise of {problem.n_joints} joints and how it "
                "correlates",
                "record for longer, or use ordinary least squares",
                where="samples",
            )
        change = np.inf
        for _ in range(ALTERNATIONS):
            factor = Factor.of(*whitened_across(problem, self.noise(problem, beta)))
            following = factor.solve()
            covariance = factor.rest / factor.freedom * factor.inverse_gram()
            errors = np.sqrt(np.diag(covariance)).clip(1e-300)
            change = float(np.max(np.abs(following - beta) / errors))
            beta = following
            if change < 1e-4:
                break
        warnings: tuple[str, ...] = ()
        if change > 0.1:
            warnings = (
                f"parameters still moved by {change:.2g} standard errors after {ALTERNATIONS} rounds",
            )
        return finished(problem, beta, covariance, warnings)

    @staticmethod
    def noise(problem: Problem, beta: np.ndarray) -> np.ndarray:
        """Covariance Sigma of the residual [N m]^2, shape (n, n); kept regular."""
        residual = problem.residual(beta)
        noise = residual.T @ residual / len(residual)
        power = 1e-24 * float((problem.torque**2).sum())
        floor = 1e-12 * max(float(np.trace(noise)), power, 1e-300)
        return noise + floor * np.eye(len(noise))


def whitened_across(
    problem: Problem, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Stacked equations whose noise is white: L^-1 W_i and L^-1 tau_i with L L^T = Sigma, shape (n, n)."""
    root = np.linalg.cholesky(noise)
    inverse = solve_triangular(root, np.eye(len(noise)), lower=True)
    matrix = (inverse @ problem.matrix).reshape(-1, problem.matrix.shape[2])
    return matrix, (problem.torque @ inverse.T).ravel()


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
ROUNDS = 20
"""Most rounds of estimating noise and parameters in turn."""


@dataclass(frozen=True)
class PartialUpdate:
    """The most probable beta under a prior N(beta_0, diag(spread^2)), with the parameters held that data hardly move.

    A parameter is influential if the data determine it at least as well as the prior does: its prior variance is at
    least ``INFLUENCE`` times the variance that data and prior together leave. The others are held at beta_0 and the
    rest is estimated anew. Noise per joint is that of the residual; its autocorrelation rho_k inflates the variance by
    1 + 2 sum_k rho_k. The covariance is the posterior one; a parameter that is
    held keeps its prior variance.

    Attributes:
        prior: beta_0, shape (b,).
        spread: standard deviation that the prior is believed to have, shape (b,); by default ``RELATIVE`` of
            |beta_0| (friction and offsets: ``FRICTION_RELATIVE``), and nowhere less than what gives ``SLIGHT`` of the
            torque.

    Source: pham1991.
    """

    prior: np.ndarray
    spread: np.ndarray | None = None

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate; raises ``InputError`` if samples are not finite, the arm rests, or the prior does not fit."""
        check_samples(problem, full_rank=False)
        prior = np.asarray(self.prior, dtype=float)
        spread = (
            default_spread(problem, prior)
            if self.spread is None
            else np.asarray(self.spread, dtype=float)
        )
        b = problem.matrix.shape[2]
        if prior.shape != (b,) or spread.shape != (b,) or not (spread > 0).all():
            raise InputError(
                f"expected {b} values, one per parameter, and spreads above 0",
                where="prior",
            )
        noise = np.hypot(
            joint_noise(problem, free_fit(problem, prior, spread)),
            START_NOISE * np.sqrt((problem.torque**2).mean(axis=0).max()),
        )
        beta, covariance, moved = self._updated(problem, prior, spread, noise)
        for _ in range(ROUNDS):
            before = beta
            noise = joint_noise(problem, beta) * np.sqrt(
                variance_inflation(problem.residual(beta), problem.group)
            )
            beta, covariance, moved = self._updated(problem, prior, spread, noise)
            if np.abs((beta - before) / spread).max() < 1e-6:
                break
        warnings = unit_warnings(problem, prior)
        if not moved.any():
            warnings += (
                "the data move no parameter: too little motion, or a prior that is already as good",
            )
        return finished(problem, beta, covariance, warnings)

    def moved(self, estimate: Estimate) -> np.ndarray:
        """Which parameters an estimate of this prior moved, shape (b,)."""
        return estimate.value != np.asarray(self.prior, dtype=float)

    def _updated(
        self, problem: Problem, prior: np.ndarray, spread: np.ndarray, noise: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Posterior mean and covariance under a noise per joint [N m], shape (n,), and which parameters moved."""
        factor = Factor.of(*whitened(problem, noise))
        gap = factor.rotated - factor.triangle @ prior
        # in units of the prior's deviation the prior precision is the identity
        triangle = factor.triangle * spread
        information = triangle.T @ triangle
        posterior = np.linalg.inv(information + np.eye(len(prior)))
        moved = np.diag(posterior) * INFLUENCE <= 1.0
        step, covariance = np.zeros(len(prior)), np.diag(spread**2)
        if moved.any():
            # parameters that the data hardly determine stay at the prior, exactly
            block = np.ix_(moved, moved)
            own = np.linalg.inv(information[block] + np.eye(int(moved.sum())))
            step[moved] = own @ (triangle[:, moved].T @ gap)
            units = spread[moved]
            covariance[block] = own * np.outer(units, units)
        return prior + spread * step, covariance, moved


def default_spread(problem: Problem, prior: np.ndarray) -> np.ndarray:
    """Prior standard deviation of a simulated arm's parameters, shape (b,)."""
    relative = np.where(_is_friction(problem.names), FRICTION_RELATIVE, RELATIVE)
    column_rms = rms(problem.matrix, axis=(0, 1))
    torque_rms = rms(problem.torque, axis=None)
    least_rms = 1e-6 * max(float(column_rms.max()), 1e-300)
    # a parameter that is zero in the prior may still add this share of the torque
    slight = SLIGHT * torque_rms / np.maximum(column_rms, least_rms)
    return np.maximum(relative * np.abs(prior), slight)


def _is_friction(names: Sequence[str]) -> np.ndarray:
    return np.array([name[0] in "bco" and name[1:].isdigit() for name in names])
