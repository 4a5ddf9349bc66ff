"""Estimators of linear equations: plain, weighted, robust, regularised, total least squares, near the nominal arm."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve, solve_triangular
from scipy.stats import norm

from gapscope.arm.errors import InputError
from gapscope.arm.root_mean_square import rms
from gapscope.ident.model.base_parameters import (
    ROUNDING,
    TINY,
    WORTH,
    Factor,
)
from gapscope.ident.samples import (
    FOLDS,
    Problem,
    check_samples,
    stretches,
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


Estimator = Callable[[Problem], Estimate]
"""Estimates the parameters of a linear problem; raises ``InputError`` if the samples cannot determine them."""


# What the linear estimators share: noise, scales, and the estimate that follows.


MIN_NOISE = 1e-3
"""Least noise over the RMS of the torque where equations have to stay well scaled beside a prior [1]."""
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
    squares = (problem.residual(beta) ** 2).sum(axis=0)
    largest = float(np.abs(problem.torque).max(initial=0.0))
    return _noise(squares, len(problem.torque), len(beta), largest)


def _noise(
    squares: np.ndarray, samples: int, parameters: int, largest_torque: float
) -> np.ndarray:
    """The same from the sums of squares of each joint's residual [N m^2], (n,)."""
    equations = samples * len(squares)
    free = max(1.0 - parameters / equations, 1.0 / equations)
    return least_noise(np.sqrt(squares / samples / free), largest_torque)


def least_noise(noise: np.ndarray, largest_torque: float) -> np.ndarray:
    """Noise of the joints [N m], (n,), of which none is zero: an exact fit has none, but weights must be finite."""
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
    problem: Problem, beta: np.ndarray, covariance: np.ndarray, *warnings: str
) -> Estimate:
    """The estimate with what it leaves per joint."""
    residual = rms(problem.residual(beta))
    return Estimate(tuple(problem.names), beta, covariance, residual, warnings)


# Equations of each joint as a factor: all that least squares with any weights of the joints need of them. Joined part
# by part they are those of a recording of any length, in memory that does not grow (demmel2012).


def joint_factors(problem: Problem) -> list[Factor]:
    """R_j, z_j of each joint: |tau_j - W_j beta|^2 = |z_j - R_j beta|^2 + rest for any beta."""
    joints = zip(problem.matrix.swapaxes(0, 1), problem.torque.T, strict=True)
    return [Factor.of(*joint) for joint in joints]


def weighted_factor(
    factors: Sequence[Factor], noise: np.ndarray | None = None
) -> Factor:
    """The factor of all equations, each joint's divided by its noise, (n,)."""
    spread = np.ones(len(factors)) if noise is None else noise
    pairs = zip(factors, spread, strict=True)
    return Factor.together([own.over(s) for own, s in pairs])


def reweighted(factors: Sequence[Factor], rounds: int) -> Factor:
    """The factor of all equations by the noise of some rounds; that of ordinary least squares at first."""
    factor = weighted_factor(factors)
    largest = max(float(np.abs(own.rotated).max()) for own in factors)
    for _ in range(rounds):
        beta = factor.solve()
        squares = np.array([own.squares(beta) for own in factors])
        noise = _noise(squares, factors[0].rows, len(beta), largest)
        factor = weighted_factor(factors, noise)
    return factor


# Weighted least squares with the noise of each joint.


def weighted_least_squares(problem: Problem, rounds: int = 2) -> Estimate:
    """Minimises sum_j |tau_j - W_j beta|^2 / s_j^2; covariance s^2 (sum_j W_j^T W_j / s_j^2)^-1.

    The noise s_j [N m] of joint j is what the fit before left of it, ordinary least squares at first; s^2 is the mean
    square of what is left, N n - b counted. That covariance holds for white noise and a model without error, which
    filtered recordings hardly ever meet; ``gapscope.ident.intervals`` has covariances that need less.

    Args:
        problem: the equations.
        rounds: how often the noise is estimated anew.

    Raises:
        InputError: the samples do not determine the parameters.

    Source: hollerbach2008, gautier2014.
    """
    factors = joint_factors(problem)
    check_samples(problem, rows=weighted_factor(factors).triangle)
    factor = reweighted(factors, rounds)
    variance = factor.rest / factor.freedom
    return finished(problem, factor.solve(), variance * factor.inverse_gram())


def ordinary_least_squares(problem: Problem) -> Estimate:
    """The same with one noise for all joints."""
    return weighted_least_squares(problem, rounds=0)


REWEIGHTINGS: dict[Estimator, int] = {
    weighted_least_squares: 2,
    ordinary_least_squares: 0,
}
"""Rounds of the estimators that need no more than the joints' factors."""


# Iteratively reweighted least squares with Huber's loss: outliers pull with bounded force.


HUBER = 1.345
"""k [1]: keeps 95 % of the efficiency under normal noise."""


def huber(problem: Problem, start: np.ndarray | None = None) -> Estimate:
    """Minimises sum rho(e / s_j) with rho(u) = u^2 / 2 for |u| <= k, k |u| - k^2 / 2 beyond.

    s_j [N m] is the median absolute residual of joint j over that of a standard normal distribution, estimated anew in
    each round. Covariance mean(psi^2) / mean(psi')^2 (W^T W)^-1 in units of s_j, with psi = rho'.

    Args:
        problem: the equations.
        start: beta of the first weights, such as the estimate of nearly the same samples, shape (b,); that of least
            squares if ``None``.

    Raises:
        InputError: the samples do not determine the parameters.

    Source: huber1981.
    """
    factors = joint_factors(problem)
    factor, largest = weighted_factor(factors), float(np.abs(problem.torque).max())
    check_samples(problem, rows=factor.triangle)
    beta = factor.solve() if start is None else start
    # columns that are orthonormal before weights: their weighted sums of squares are well-conditioned
    square = solve_triangular(factor.triangle, np.eye(len(beta)))
    columns = (problem.matrix @ square).reshape(-1, len(beta))

    def scaled(beta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals over their joint's spread, (N, n), and the spread [N m], (n,)."""
        residual = problem.residual(beta)
        # the median is not moved by outliers
        spread = np.median(np.abs(residual), axis=0) / norm.ppf(0.75)
        spread = np.maximum(spread, 1e-9 * largest + TINY)
        return residual / spread, spread

    for _ in range(ROUNDS):
        u, spread = scaled(beta)
        # weights min(1, k / |u|)
        weights = HUBER / np.maximum(np.abs(u), HUBER) / spread**2
        weighted = columns * weights.reshape(-1, 1)
        right = weighted.T @ problem.torque.ravel()
        following = square @ solve(weighted.T @ columns, right, assume_a="pos")
        moved = np.abs(problem.matrix @ (following - beta)).max()
        change = float(moved) / max(largest, TINY)
        beta = following
        if change < SETTLED:
            break
    warnings = []
    if change >= SETTLED:
        warnings.append(
            f"reweighting still moved the torque by {change:.1e} after {ROUNDS} rounds"
        )
    # Huber's asymptotic covariance: E[psi^2] / E[psi']^2 (W^T W)^-1 in units of each joint's spread
    u, spread = scaled(beta)
    inside = np.mean(np.abs(u) <= HUBER)
    freedom = max(u.size - len(beta), 1)
    variance = np.sum(np.clip(u, -HUBER, HUBER) ** 2) / freedom / inside**2
    inverse = weighted_factor(factors, spread).inverse_gram()
    return finished(problem, beta, variance * inverse, *warnings)


# Ridge regression, its strength chosen by held-out motions or the L-curve.


STRENGTHS = np.logspace(-12, 1, 131)
"""Strengths that are tried."""


class _Directions:
    """tau - W beta_0 along the singular directions of W D^-1, each joint's equations over its noise.

    Args:
        problem: the equations.
        prior: beta_0, zero if ``None``.

    Attributes:
        prior: beta_0, (b,).
        norms: D of W's columns, (b,).
        factor: of W D^-1.
        values, right, part: its singular values s, V^T, and U^T z.

    Raises:
        InputError: samples are not finite or the arm rests.
    """

    def __init__(self, problem: Problem, prior: np.ndarray | None) -> None:
        check_samples(problem, full_rank=False)
        b = problem.matrix.shape[2]
        self.prior = np.zeros(b) if prior is None else np.array(prior, float)
        noise = joint_noise(problem, free_fit(problem, self.prior))
        matrix, torque = whitened(problem, noise)
        self._problem, self.norms = problem, column_norms(matrix)
        self._rows = np.column_stack(
            [matrix / self.norms, torque - matrix @ self.prior]
        )
        self.factor = Factor.of(self._rows[:, :-1], self._rows[:, -1])
        left, self.values, self.right = np.linalg.svd(self.factor.triangle)
        self.part = left.T @ self.factor.rotated

    def estimate(self, gain: np.ndarray, *warnings: str) -> Estimate:
        """beta = beta_0 + D^-1 sum_i g_i v_i u_i^T (tau - W beta_0), with what counts of each direction, s_i g_i."""
        decided = self.values * gain
        unexplained = (1 - decided) * self.part
        squares = self.factor.rest + float(unexplained @ unexplained)
        noise = squares / max(self.factor.rows - float(decided.sum()), 1.0)
        half = self.right.T * gain / self.norms[:, None]
        beta = self.prior + half @ self.part
        return finished(self._problem, beta, noise * half @ half.T, *warnings)

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
        group = self._problem.group
        parts = group_slices(group)
        if len(parts) <= 2:
            parts = stretches(group)
        every = self._rows.reshape(len(group), -1, self._rows.shape[1])
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


def ridge(
    problem: Problem,
    prior: np.ndarray | None = None,
    choice: str | float | None = None,
) -> Estimate:
    """Minimises |tau - W beta|^2 + lambda |D (beta - beta_0)|^2, D the norms of W's columns, each joint over its noise.

    With columns of unit norm lambda has no unit: it is compared with the squared singular values, of which none
    exceeds b. The covariance is that of the noise alone; what the pull adds as bias is not in it.

    Args:
        problem: the equations.
        prior: beta_0, shape (b,); zero if ``None``.
        choice: lambda itself; ``l_curve`` (the sharpest corner of log |residual| against log |D (beta - beta_0)|); or
            ``None``: the strongest that predicts motions as well as any that were not fitted.

    Raises:
        InputError: samples are not finite or the arm rests.

    Source: hansen1992.
    """
    found = _Directions(problem, prior)
    # along each singular direction the prior weighs as much as the data at values**2 = strength
    if choice is None:
        chosen = found.strongest(lambda own: 1 / (own + STRENGTHS[:, None]))
        strength = float(STRENGTHS[chosen])
    elif choice == "l_curve":
        strength = _at_corner(found)
    else:
        strength = float(choice)
    gain = found.values / np.maximum(found.values**2 + strength, TINY)
    b, effective = len(gain), float((found.values * gain).sum())
    # what holds less than one direction is no pull to speak of
    if b - effective < 1:
        return found.estimate(gain)
    return found.estimate(
        gain,
        f"the pull holds {b - effective:.1f} of {b} directions; their stated deviation leaves out the bias that this "
        "adds; record a trajectory that excites them",
    )


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
    # along a curve that stands still a curvature is rounding
    curvature = cross / np.maximum(dx**2 + dy**2, ROUNDING) ** 1.5
    # the differences at the ends are one-sided
    corner = int(np.argmax(curvature[2:-2]) + 2)
    # a corner at which the fit is much worse is none
    last_good = int((residual <= (1 + WORTH) * residual[0]).sum()) - 1
    return float(STRENGTHS[min(corner, last_good)])


# Truncated singular value decomposition: directions that the samples hardly excite stay at the prior.


def truncated_svd(
    problem: Problem, prior: np.ndarray | None = None, count: int | None = None
) -> Estimate:
    """beta = beta_0 + D^-1 sum_{i <= k} v_i u_i^T (tau - W beta_0) / s_i, with W D^-1 = U S V^T of unit columns.

    Each joint's equations are divided by its noise.

    Args:
        problem: the equations.
        prior: beta_0, shape (b,); zero if ``None``.
        count: k itself; ``None``: the least that predicts motions as well as any that were not fitted.

    Raises:
        InputError: samples are not finite or the arm rests.

    Source: hansen1987.
    """
    found = _Directions(problem, prior)
    b = len(found.values)
    # squared singular values ascend: the last k are kept
    kept = np.arange(b)[::-1] < np.arange(b, -1, -1)[:, None]

    def filters(values: np.ndarray) -> np.ndarray:
        regular = kept & (values > 1e-13 * values[-1])
        return np.where(regular, 1 / np.maximum(values, TINY), 0.0)

    rank = b - found.strongest(filters) if count is None else count
    gain = np.where(np.arange(b) < rank, 1 / np.maximum(found.values, TINY), 0.0)
    if rank >= b:
        return found.estimate(gain)
    return found.estimate(
        gain,
        f"{b - rank} of {b} directions were dropped and stay at the prior; their deviation is not stated; record a "
        "trajectory that excites them",
    )


# Total least squares: the regressor has errors too, since velocity and acceleration come from noisy positions.


def total_least_squares(problem: Problem) -> Estimate:
    """Minimises |[dW D^-1, dtau / s]|_F^2 with (W + dW) beta = tau + dtau, by the least right singular vector.

    D and s are the RMS of the columns and of the torque: the answer is consistent if rows have independent errors of
    these relative sizes, and only as good as that assumption. Covariance s^2 (1 + |x|^2) (A^T A - M s^2 I)^-1 in
    scaled columns.

    Raises:
        InputError: the samples do not determine the parameters.

    Source: vanhuffel1991.
    """
    check_samples(problem)
    equations = np.column_stack(problem.stacked())
    b, scale = equations.shape[1] - 1, rms(equations)
    triangle = np.asarray(np.linalg.qr(equations / scale, mode="r"))
    values, right = np.linalg.svd(triangle)[1:]
    # the solution divides by the last component
    if abs(right[-1, -1]) < ROUNDING:
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


def maximum_likelihood(problem: Problem) -> Estimate:
    """Maximises the likelihood of normal noise with covariance Sigma [N m]^2, shape (n, n), over beta and Sigma.

    Alternates beta = (sum_i W_i^T Sigma^-1 W_i)^-1 sum_i W_i^T Sigma^-1 tau_i and Sigma = mean of e_i e_i^T, which
    raises the likelihood in each round. Covariance (sum_i W_i^T Sigma^-1 W_i)^-1.

    Raises:
        InputError: the samples do not determine the parameters, or fewer samples than joints leave Sigma without an
            inverse.

    Source: swevers2007.
    """
    beta = ordinary_least_squares(problem).value
    if len(problem.torque) <= problem.n_joints:
        raise InputError(
            f"{len(problem.torque)} samples cannot give the noise of {problem.n_joints} joints and how it "
            "correlates",
            "record for longer, or use ordinary least squares",
            where="samples",
        )
    for _ in range(ROUNDS):
        # L^-1 W_i and L^-1 tau_i have white noise if L L^T = Sigma
        root = np.linalg.cholesky(noise_across(problem, beta))
        inverse = solve_triangular(root, np.eye(len(root)), lower=True)
        matrix = (inverse @ problem.matrix).reshape(-1, len(beta))
        factor = Factor.of(matrix, (problem.torque @ inverse.T).ravel())
        following = factor.solve()
        covariance = factor.rest / factor.freedom * factor.inverse_gram()
        errors = np.sqrt(np.diag(covariance)) + TINY
        change = float(np.max(np.abs(following - beta) / errors))
        beta = following
        if change < SETTLED:
            return finished(problem, beta, covariance)
    moved = f"parameters still moved by {change:.2g} standard errors"
    return finished(problem, beta, covariance, f"{moved} after {ROUNDS} rounds")


def noise_across(problem: Problem, beta: np.ndarray) -> np.ndarray:
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
"""And a parameter near 0 by what gives this share of the torque's RMS [1]; more of it is worth a warning."""
INFLUENCE = 2.0
"""Least ratio of variances of a parameter that moves [1]."""


def partial_update(problem: Problem, prior: np.ndarray) -> Estimate:
    """The most probable beta under a prior N(beta_0, diag(spread^2)), with the parameters held that data hardly move.

    The prior is believed to be off by ``RELATIVE`` of |beta_0| (friction and offsets: ``FRICTION_RELATIVE``), and
    nowhere by less than what gives ``SLIGHT`` of the torque.

    A parameter is influential if the data determine it at least as well as the prior does: its prior variance is at
    least ``INFLUENCE`` times the variance that data and prior together leave. The others are held at beta_0, exactly,
    and the rest is estimated anew. Noise per joint is that of the residual; its autocorrelation rho_k inflates the
    variance by 1 + 2 sum_k rho_k. The covariance is the posterior one; a parameter that is held keeps its prior
    variance.

    Args:
        problem: the equations.
        prior: beta_0, shape (b,).

    Raises:
        InputError: samples are not finite or the arm rests.

    Source: pham1991.
    """
    check_samples(problem, full_rank=False)
    friction = [re.fullmatch(r"[bco]\d+", name) is not None for name in problem.names]
    relative = np.where(friction, FRICTION_RELATIVE, RELATIVE)
    column_rms = rms(problem.matrix, axis=(0, 1))
    least_rms = 1e-6 * column_rms.max() + TINY
    # a parameter that is zero in the prior may still add this share of the torque
    slight = SLIGHT * rms(problem.torque, axis=None) / np.maximum(column_rms, least_rms)
    spread = np.maximum(relative * np.abs(prior), slight)
    free = joint_noise(problem, free_fit(problem, prior, spread))
    # few samples leave a free fit nothing: at first something slight counts as noise
    noise = np.hypot(free, SLIGHT * rms(problem.torque).max())
    beta = np.full(len(prior), np.inf)
    for _ in range(ROUNDS):
        before = beta
        factor = Factor.of(*whitened(problem, noise))
        gap = factor.rotated - factor.triangle @ prior
        # in units of the prior's deviation the prior precision is the identity
        triangle = factor.triangle * spread
        precision = triangle.T @ triangle + np.eye(len(prior))
        moved = np.diag(np.linalg.inv(precision)) * INFLUENCE <= 1.0
        own = np.linalg.inv(precision[np.ix_(moved, moved)])
        beta = prior.copy()
        beta[moved] += spread[moved] * (own @ (triangle[:, moved].T @ gap))
        if np.abs((beta - before) / spread).max() < SETTLED:
            break
        inflation = variance_inflation(problem.residual(beta), problem.group)
        noise = joint_noise(problem, beta) * np.sqrt(inflation)
    covariance = np.eye(len(prior))
    covariance[np.ix_(moved, moved)] = own
    covariance *= np.outer(spread, spread)
    warnings = unit_warnings(problem, prior)
    if np.array_equal(beta, prior):
        warnings += (
            "the data move no parameter: too little motion, or a prior that is already as good",
        )
    return finished(problem, beta, covariance, *warnings)
