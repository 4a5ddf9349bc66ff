"""Sums of squares and products of a search, and posteriors of values."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, cho_solve, solve_triangular
from scipy.linalg.lapack import dpotrf

from gapscope.diagnosis.thresholds import (
    INERTIAL_ERROR,
    INERTIAL_ERROR_FACTOR,
    INERTIAL_ERRORS,
    LINK_TO_LINK,
    NOMINAL_ERROR,
)

# What a diagnosis believes of the nuisances: errors of the nominal arm and of its sensors.


@dataclass(frozen=True)
class ErrorSizes:
    """Sizes that the errors of the nominal arm may have when the intervals of values are drawn.

    Not the levels of the search: these cost evidence, so that errors do not replace effects, and the smallest that
    suits the data is preferred. Intervals have to hold whatever the size is.

    Attributes:
        roots: R of the covariance R R^T of the nuisances at each size, (K, k) each.
        log_prior: of the sizes, up to a constant [nats].
        unseen: chance that errors that the data do not show have the size of the column, if those that they do show
            have the size of the row, (L, L): sizes differ from link to link.
    """

    roots: tuple[np.ndarray, ...]
    log_prior: np.ndarray
    unseen: np.ndarray


@dataclass(frozen=True)
class NuisancePrior:
    """Prior of the K nuisances, at several levels of how far the nominal arm may be off.

    Attributes:
        precision: of the nuisances at each level, (K, K).
        levels: the levels that are tried, each with its charge [nats].
        sizes: what intervals of values are drawn from.
    """

    precision: Mapping[float, np.ndarray]
    levels: Mapping[float, float]
    sizes: ErrorSizes

    def at(self, level: float) -> np.ndarray:
        """Precision of the nuisances at a level, (K, K)."""
        return self.precision[level]


def data_sheet_prior(errors: np.ndarray, others: int) -> NuisancePrior:
    """Errors of the inertials, which a level scales, and of others in units of their spread.

    The search takes relative errors of the inertials as independent; intervals take those of one body together.

    Args:
        errors: root of the covariance of inertials that are off by their own size, (10 n, 10 n).
        others: number of the other nuisances.
    """
    precision = {}
    for level in NOMINAL_ERROR:
        of_inertials = np.full(len(errors), 1.0 / level**2)
        precision[level] = np.diag(np.concatenate([of_inertials, np.ones(others)]))
    sizes = ErrorSizes(
        tuple(block_diag(size * errors, np.eye(others)) for size in INERTIAL_ERRORS),
        _log_normal(INERTIAL_ERRORS / INERTIAL_ERROR, INERTIAL_ERROR_FACTOR),
        _unseen(INERTIAL_ERRORS),
    )
    return NuisancePrior(precision, NOMINAL_ERROR, sizes)


def _log_normal(ratio: np.ndarray, factor: float) -> np.ndarray:
    """Logarithm of a density by which ratios of ``factor`` and one over it are one deviation off [nats]."""
    return np.asarray(-0.5 * (np.log(ratio) / np.log(factor)) ** 2)


def _unseen(sizes: np.ndarray) -> np.ndarray:
    """Chances of the sizes of one link's errors, by row that of another's, (L, L)."""
    density = np.exp(_log_normal(sizes / sizes[:, None], LINK_TO_LINK))
    return np.asarray(density / density.sum(axis=1, keepdims=True))


# Weighted normal equations of the terms, the nominal arm's errors eliminated.


LIFTS = (1e-13, 1e-11, 1e-9, 1e-7, 1e-5)
"""What is added to a unit diagonal until a matrix is positive definite in spite of rounding [1]."""
MIN_SQUARE = 1e-8
"""What a parameter of one unit changes in the sum of squares, below which the data do not tell it [1].

The centre of a load along parallel axes, as of a planar arm, leaves rounding alone, 1e-16.
"""


class NormalEquations:
    """Normal equations of some folds for P parameters of terms, with K nuisances under a Gaussian prior.

    For given parameters the best nuisance is affine in them, delta = D [theta; 1], so that everything that is asked of
    a set of terms can be asked of matrices over [theta; 1] alone. Several such equations can be held at once: then all
    arrays have a first axis of F, and F solutions come from one call.

    Args:
        total: X^T W X of X = [A, N, y], shape (P + K + 1, P + K + 1), or F of them. Of [A, N, y, d], one more, the
            equations of any skew of sampling follow, see ``at``, and only these can be solved.
        size: P.
        prior: precision of the nuisances, in their units, (K, K).
        bounds: lower bounds of the parameters at which values stop, (P,); ``None`` for none.

    Attributes:
        nuisance_precision: of the nuisances, those of the data and of the prior, (K, K).
        delta: D, shape (K, P + 1).
        least: L, with |[theta; -1]|^2_L the least sum of squares over all nuisances, theirs included, (P + 1, P + 1).
    """

    def __init__(
        self,
        total: np.ndarray,
        size: int,
        prior: np.ndarray,
        bounds: np.ndarray | None = None,
    ) -> None:
        self.size, self.prior, self.bounds = size, prior, bounds
        nuisances = slice(size, size + len(prior))
        self.nuisance_precision = total[..., nuisances, nuisances] + prior
        outer = np.delete(np.arange(total.shape[-1]), nuisances)
        right = total[..., nuisances, outer]
        reduced = solve_positive(self.nuisance_precision, right)
        sign = np.ones(len(outer))
        sign[:size] = -1.0
        self.delta = reduced * sign
        own = total[..., outer[:, None], outer]
        self.least = own - np.swapaxes(right, -1, -2) @ reduced

    def at(self, skew: float) -> NormalEquations:
        """The equations of [A, N, y - skew d] from those of [A, N, y, d]; what eliminates the nuisances is the same."""
        other = copy(self)
        other.least = with_skew(self.least, skew)
        other.delta = self.delta[..., :-1].copy()
        other.delta[..., -1] -= skew * self.delta[..., -1]
        return other

    def solve(self, columns: np.ndarray) -> np.ndarray:
        """Values of the terms in ``columns``, zeros elsewhere, shape (P,) or (F, P)."""
        return solve(self.least, columns, self.bounds)

    def rest(
        self,
        gram: np.ndarray,
        theta: np.ndarray,
        columns: np.ndarray,
        skew: float = 0.0,
        *,
        corrected: bool,
    ) -> np.ndarray:
        """|y - skew d - A theta - N delta|^2 per joint, shape (n,) or (F, n), >= 0.

        Args:
            gram: X^T X of X = [A, N, y, d] per joint, shape (n, P + K + 2, P + K + 2), or F of them.
            theta: values of the terms, zero outside ``columns``, shape (P,) or (F, P).
            columns: places of the terms.
            skew: of sampling [s].
            corrected: whether the nuisances are taken out; otherwise delta counts as zero.
        """
        last = gram.shape[-1] - 1
        own = np.append(columns, [last - 1, last]).astype(int)
        z = np.ones((*theta.shape[:-1], 1, len(own)))
        z[..., 0, :-2] = -theta[..., columns]
        z[..., 0, -1] = -skew
        squares = _form(z, gram[..., own[:, None], own], z)
        if corrected:
            nuisances = slice(self.size, -2)
            delta = self.nuisance(theta, columns)[..., None, :]
            cross = _form(z, gram[..., own, nuisances], delta)
            within = _form(delta, gram[..., nuisances, nuisances], delta)
            squares += within - 2 * cross
        return np.maximum(squares, 0.0)

    def nuisance(self, theta: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """The best nuisances delta for given values of the terms, shape (K,) or (F, K)."""
        slope, values = self.delta[..., columns], theta[..., columns, None]
        return np.asarray((slope @ values)[..., 0] + self.delta[..., -1])


def _form(left: np.ndarray, matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """x^T A y over the last axes, of x (..., a), A (..., a, b) and y (..., b)."""
    return np.asarray((left * (matrix @ right[..., None])[..., 0]).sum(axis=-1))


def with_skew(gram: np.ndarray, skew: float) -> np.ndarray:
    """Normal equations of [A, N, y - skew d] from those of [A, N, y, d]; over the last two axes."""
    out = gram[..., :-1, :-1]
    if skew == 0:
        return out
    out = out.copy()
    # X^T (y - s d) = X^T y - s X^T d
    out[..., :-1, -1] -= skew * gram[..., :-2, -1]
    out[..., -1, :-1] = out[..., :-1, -1]
    # |y - s d|^2 = |y|^2 - 2 s y^T d + s^2 |d|^2
    out[..., -1, -1] += skew**2 * gram[..., -1, -1] - 2 * skew * gram[..., -2, -1]
    return out


def solve(
    least: np.ndarray, columns: np.ndarray, bounds: np.ndarray | None = None
) -> np.ndarray:
    """Where |[theta; -1]|^2_L is least over the terms in ``columns``, others zero; (..., P) from L (..., P + 1, P + 1).

    Values that fall below their lower bounds, (P,), are fixed there, and the others fitted again.
    """
    theta = np.zeros(least.shape[:-1])[..., :-1]
    columns = np.asarray(columns, dtype=int)
    if not len(columns):
        return theta
    block, right = least[..., columns[:, None], columns], least[..., columns, -1]
    lowest = None if bounds is None else bounds[columns]
    theta[..., columns] = _bounded(block, right, lowest)
    return theta


def _bounded(
    block: np.ndarray, right: np.ndarray, bounds: np.ndarray | None
) -> np.ndarray:
    """Solutions of normal equations (..., C, C), (..., C); what falls below its bound is fixed there, step by step."""
    values = _least_squares(block, right)
    if bounds is None:
        return values
    bounds = np.broadcast_to(bounds, values.shape)
    low = (values < bounds).any(axis=-1)
    if low.any():
        values[low] = _fixed_at(bounds[low], block[low], right[low], values[low])
    return values


def _fixed_at(
    bounds: np.ndarray, block: np.ndarray, right: np.ndarray, values: np.ndarray
) -> np.ndarray:
    """The same of B equations whose plain solutions (B, C) fall below a bound somewhere."""
    fixed = np.zeros(values.shape, dtype=bool)
    todo = np.arange(len(values))
    while len(todo):
        below = ~fixed[todo] & (values[todo] < bounds[todo])
        todo = todo[below.any(axis=1)]
        fixed[todo] |= below[below.any(axis=1)]
        free = ~fixed[todo]
        at_bounds = np.where(free, 0.0, bounds[todo])
        # what is fixed goes to the right-hand side, and its own equation says nothing
        known = right[todo] - (block[todo] @ at_bounds[..., None])[..., 0]
        kept = block[todo] * (free[:, :, None] & free[:, None, :])
        found = _least_squares(kept, np.where(free, known, 0.0))
        values[todo] = np.where(free, found, at_bounds)
    return values


def _least_squares(block: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solutions of normal equations whose columns are brought to one size; a column that does nothing gets zero."""
    diagonal = np.diagonal(block, axis1=-2, axis2=-1)
    told = diagonal > MIN_SQUARE
    # of a column that is not told nothing is left but the ridge's share of the diagonal
    scale = np.where(told, 1.0 / np.sqrt(np.where(told, diagonal, 1.0)), 0.0)
    scaled = block * scale[..., :, None] * scale[..., None, :]
    scaled += 1e-9 * np.eye(block.shape[-1])
    solved = np.linalg.solve(scaled, (scale * right)[..., None])
    return np.asarray(scale * solved[..., 0])


def solve_positive(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """A^-1 B of a positive definite A, its columns brought to one size, so that units of any size may meet in it.

    With a first axis of F on both, F solutions.
    """
    if matrix.ndim > 2:
        pairs = zip(matrix, right, strict=True)
        return np.array([solve_positive(a, b) for a, b in pairs])
    scale, root = positive_root(matrix)
    solved = cho_solve((root, True), scale[:, None] * right)
    return np.asarray(scale[:, None] * solved)


def positive_root(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """S and the lower triangle R with S^-1 R R^T S^-1 = A for a positive definite A, (K,) and (K, K).

    Where rounding takes eigenvalues of A below zero, A is lifted by as little of its diagonal as makes it definite.

    Raises:
        numpy.linalg.LinAlgError: A is far from positive definite.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix * scale[:, None] * scale
    for lift in LIFTS:
        root, failed = dpotrf(scaled + lift * np.eye(len(matrix)), lower=1)
        if not failed:
            return scale, np.tril(root)
    raise np.linalg.LinAlgError("normal equations are not positive definite")


# How likely values of some terms are beside errors of the nominal arm whose size is not known.
#
# With A the columns of the terms, N those of the nuisances, W weights of one over variance, and R_s the root of the
# covariance of nuisances of size s,
#
#     y = A theta + N R_s u + e        u ~ N(0, 1), e ~ N(0, W^-1), theta flat or Gaussian
#     p(s | y) ~ p(s) |G_s|^-1/2 exp(1/2 r_s^T G_s^-1 r_s)        G_s = X_s^T W X_s + Q, r_s = X_s^T W y
#
# with X_s = [A, N R_s] and Q the prior precision, 1 for u: the restricted likelihood of s [patterson1971].
#
# The errors that the data show tell s. What widens an interval is those that they do not show, as the terms take their
# place, and they may be of another size: values are drawn for sizes drawn about those of p(s | y).


@dataclass(frozen=True)
class Posterior:
    """Values of some terms, Gaussian for one size of the nuisances.

    Attributes:
        columns: places of the terms, (C,).
        mean: of the values, (C,).
        root: B of the values' covariance B B^T, (C, D).
        log_evidence: of the size, up to a constant [nats].
    """

    columns: np.ndarray
    mean: np.ndarray
    root: np.ndarray
    log_evidence: float

    def draws(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Values, (count, C)."""
        noise = rng.normal(size=(count, self.root.shape[1]))
        return np.asarray(self.mean + noise @ self.root.T)


def posteriors(
    total: np.ndarray, columns: np.ndarray, precision: np.ndarray, sizes: ErrorSizes
) -> list[Posterior]:
    """The values under every size.

    Args:
        total: X^T W X of X = [A, N, y], (P + K + 1, P + K + 1).
        columns: places of the terms, (C,).
        precision: prior precision of all P values, zero if flat, (P,).
        sizes: of the K nuisances.
    """
    own = precision[columns]
    used = np.append(columns, np.arange(len(precision), len(total)))
    chosen = total[np.ix_(used, used)]
    return [
        _posterior(chosen, columns, own, root, float(log_prior))
        for root, log_prior in zip(sizes.roots, sizes.log_prior, strict=True)
    ]


def drawn(
    among: Sequence[Sequence[Posterior]],
    unseen: np.ndarray,
    size: int,
    rng: np.random.Generator,
    count: int,
) -> np.ndarray:
    """Values from some sets of terms, each under every size, as likely as the data make either, (count, P).

    Args:
        among: of each set of terms the posteriors under all sizes.
        unseen: see ``ErrorSizes``.
        size: P.
        rng: source of random numbers.
        count: number of draws.
    """
    log_evidence = np.array([[one.log_evidence for one in sizes] for sizes in among])
    chance = np.exp(log_evidence - log_evidence.max()) @ unseen
    counts = rng.multinomial(count, (chance / chance.sum()).ravel())
    out = np.zeros((count, size))
    start = 0
    for one, number in zip(itertools.chain(*among), counts, strict=True):
        rows = slice(start, start + number)
        out[rows, one.columns] = one.draws(rng, number)
        start += number
    return out


def _posterior(
    total: np.ndarray,
    columns: np.ndarray,
    precision: np.ndarray,
    root: np.ndarray,
    log_prior: float,
) -> Posterior:
    """The values under one size: X^T W X over the terms alone, (C + K + 1, C + K + 1), their precision, (C,)."""
    own, errors = len(columns), root.shape[1]
    # from [theta, u, 1] to [theta, delta, 1]
    to_errors = np.zeros((len(total), own + errors + 1))
    to_errors[:own, :own] = np.eye(own)
    to_errors[own:-1, own:-1] = root
    to_errors[-1, -1] = 1.0
    whole = to_errors.T @ total @ to_errors
    gram, right = whole[:-1, :-1], whole[:-1, -1]
    gram += np.diag(np.append(precision, np.ones(errors)))
    scale, lower = positive_root(gram)
    # G = S^-1 L L^T S^-1, so that its inverse is B B^T with B = S L^-T
    inverse = solve_triangular(lower, np.eye(len(lower)), lower=True)
    inverse_root = scale[:, None] * inverse.T
    reduced = inverse_root.T @ right
    log_det = 2.0 * float((np.log(np.diag(lower)) - np.log(scale)).sum())
    proper = float(np.log(precision[precision > 0]).sum())
    log_evidence = log_prior + 0.5 * (float(reduced @ reduced) - log_det + proper)
    return Posterior(
        columns, inverse_root[:own] @ reduced, inverse_root[:own], log_evidence
    )
