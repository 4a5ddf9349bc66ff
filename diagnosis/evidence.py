"""Evidence for a set of terms: how well it predicts recordings that it was not fitted to, less what it costs.

Score of a set S, in nats, over folds f (one recording left out each) and joints j:

    score = -1/2 sum_fj n_fj log(1 + mse_fj / floor_fj^2) - charge(S) - 1/2 (|delta / sigma|^2 + log det)

with n the effective number of samples, mse the mean square of the unseen gap, and delta the errors of the nominal
inertials, a nuisance that every model may use and pays for by its size relative to sigma. A second nuisance is the skew
between torque and motion that sampling leaves, the same on all joints: a torque held from one tick of the controller to
the next acts half a tick late on average.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from diagnosis.linear import Linearisation
from diagnosis.terms import Term, count_effects

NEW_EFFECT = 20.0
"""Charge for each different effect [nats]: the logarithm of the number of ways to name one, and a margin for what the
effective number of samples overstates."""
NOMINAL_ERROR = (0.003, 0.01, 0.03, 0.06)
"""Relative errors sigma of the nominal inertials that are tried; the evidence chooses."""
SKEWS = (0.0, 2.5e-4, 5e-4)
"""Skews of sampling that are tried [s]; half a tick is 0.5 ms at 1 kHz."""
LEAST_DELAY = 1e-3
"""Delays shorter than this are taken for a skew of sampling and not named [s]."""
SKEW_CHARGE = 3.0
"""What a skew costs [nats]."""


@dataclass(frozen=True)
class Fit:
    """A set of terms fitted.

    Attributes:
        terms: the set.
        score: evidence [nats].
        theta: values fitted to all folds, shape (P,).
        delta: errors of the nominal inertials in their units, shape (K,).
        unseen: mean square of the gap per fold and joint, each fold predicted from the others [N^2 m^2], (F, n).
    """

    terms: frozenset[Term]
    score: float
    theta: np.ndarray
    delta: np.ndarray
    unseen: np.ndarray


@dataclass(frozen=True)
class _Normal:
    """Weighted normal equations of some folds, the nuisance eliminated."""

    schur: np.ndarray
    right: np.ndarray
    nuisance: tuple[np.ndarray, bool]
    cross: np.ndarray
    nuisance_right: np.ndarray

    def solve(self, columns: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
        """Values of the terms in ``columns`` (zeros elsewhere), and of the nuisance."""
        theta = np.zeros(size)
        if len(columns):
            block = self.schur[np.ix_(columns, columns)]
            scale = 1.0 / np.sqrt(np.maximum(np.diag(block), 1e-12))
            scaled = block * scale[:, None] * scale + 1e-9 * np.eye(len(columns))
            theta[columns] = scale * np.linalg.solve(scaled, scale * self.right[columns])
        return theta, cho_solve(self.nuisance, self.nuisance_right - self.cross @ theta)


class Evidence:
    """Scores sets of terms on one linearisation.

    Args:
        linearisation: normal equations per fold and joint.
        unseen: mean square of the gap per fold and joint under the model so far, for the weights, (F, n).
        sigma: relative error of the nominal inertials.
        skew: skew of sampling [s].
    """

    def __init__(self, linearisation: Linearisation, unseen: np.ndarray, sigma: float, skew: float) -> None:
        self.linear, self.sigma, self.skew = linearisation, sigma, skew
        self.terms = linearisation.terms
        folds = linearisation.folds
        raw = np.array([fold.gram.sum(axis=0) for fold in folds])
        self.gram = _with_skew(raw, skew)
        self._plain = _with_skew(raw, 0.0)
        self.rows = np.array([fold.rows.sum(axis=0) for fold in folds])
        self.floor2 = np.array([fold.floor for fold in folds]) ** 2
        self.independent = np.array([fold.independent for fold in folds])
        self.weights = self.independent / self.rows / (unseen + self.floor2)
        weighted = (self.gram * self.weights[:, :, None, None]).sum(axis=1)
        total = weighted.sum(axis=0)
        self._all = self._normal(total)
        self._without = [self._normal(total - w) for w in weighted] if len(weighted) > 1 else [self._all]
        self.lowest = _lowest(linearisation)
        k = self.gram.shape[-1] - 1 - self.terms.size
        information = total[self.terms.size : -1, self.terms.size : -1] * sigma**2
        self._log_det = 0.5 * float(np.linalg.slogdet(np.eye(k) + information)[1])
        self.per_parameter = 0.5 * float(np.log(self.independent.sum()))

    def _normal(self, total: np.ndarray) -> _Normal:
        p = self.terms.size
        nuisance = total[p:-1, p:-1] + np.eye(total.shape[0] - 1 - p) / self.sigma**2
        factor = cho_factor(nuisance, lower=True)
        cross = total[p:-1, :p]
        right = total[p:-1, -1]
        reduced = cho_solve(factor, np.column_stack([cross, right]))
        return _Normal(
            total[:p, :p] - cross.T @ reduced[:, :-1], total[:p, -1] - cross.T @ reduced[:, -1], factor, cross, right
        )

    def fit(self, terms: frozenset[Term]) -> Fit:
        """Fit and score a set of terms; the score is minus infinity where a value could not be."""
        columns = _columns(terms)
        theta, delta = self._all.solve(columns, self.terms.size)
        unseen = self.unseen(terms)
        score = -0.5 * float((self.independent * np.log1p(unseen / self.floor2)).sum())
        score -= (
            self.charge(terms)
            + SKEW_CHARGE * (self.skew > 0)
            + 0.5 * float(delta @ delta) / self.sigma**2
            + self._log_det
        )
        if not self.terms.feasible(theta, terms, self.lowest):
            score = -np.inf
        return Fit(terms, score, theta, delta, unseen)

    def charge(self, terms: frozenset[Term]) -> float:
        """What a set costs [nats]: half the logarithm of the samples per parameter, and so much per effect named."""
        return self.per_parameter * sum(len(t.columns) for t in terms) + NEW_EFFECT * count_effects(terms)

    def bootstrap(self, terms: frozenset[Term], rng: np.random.Generator, draws: int = 200) -> np.ndarray:
        """Values of the terms on pieces of the data drawn with replacement, shape (draws, P): a block bootstrap."""
        pieces = np.concatenate(
            [
                np.einsum("bjxy,j->bxy", _with_skew(fold.gram, self.skew), w)
                for fold, w in zip(self.linear.folds, self.weights, strict=True)
            ]
        )
        values = np.empty((draws, self.terms.size))
        for draw in range(draws):
            counts = np.bincount(rng.integers(len(pieces), size=len(pieces)), minlength=len(pieces)).astype(float)
            total = np.tensordot(counts, pieces, axes=1)
            values[draw] = self._normal(total).solve(_columns(terms), self.terms.size)[0]
        return values

    def left_out(self, terms: frozenset[Term]) -> list[np.ndarray]:
        """Values of the terms fitted without each of the folds, F arrays of shape (P,)."""
        return [normal.solve(_columns(terms), self.terms.size)[0] for normal in self._without]

    def unseen(self, terms: frozenset[Term], *, corrected: bool = True) -> np.ndarray:
        """Mean square of the gap on each fold under values fitted to the others [N^2 m^2], (F, n).

        ``corrected`` says whether the nuisances, errors of the nominal inertials and skew, are taken out as well.
        """
        return self._mean_square(terms, self._without, corrected)

    def seen(self, terms: frozenset[Term]) -> np.ndarray:
        """Mean square of the gap on each fold under values fitted to all folds [N^2 m^2], (F, n)."""
        return self._mean_square(terms, [self._all] * len(self.rows), False)

    def _mean_square(self, terms: frozenset[Term], normals: list[_Normal], corrected: bool) -> np.ndarray:
        out = np.empty_like(self.rows)
        gram = self.gram if corrected else self._plain
        for f, normal in enumerate(normals):
            theta, delta = normal.solve(_columns(terms), self.terms.size)
            z = np.concatenate([-theta, -delta * corrected, [1.0]])
            out[f] = np.maximum(np.einsum("a,jab,b->j", z, gram[f], z, optimize=True), 0.0) / self.rows[f]
        return out


def _columns(terms: frozenset[Term]) -> np.ndarray:
    return np.array(sorted(c for t in terms for c in t.columns), dtype=int)


def _with_skew(gram: np.ndarray, skew: float) -> np.ndarray:
    """Normal equations of [A, N, y - skew d] from those of [A, N, d, y]; over the last two axes."""
    size = gram.shape[-1]
    to = np.zeros((size, size - 1))
    to[:-2, :-1] = np.eye(size - 2)
    to[-2, -1], to[-1, -1] = -skew, 1.0
    return to.T @ gram @ to


def _lowest(linearisation: Linearisation) -> np.ndarray:
    """Lowest values: friction, armature and the last link's mass may not fall below zero in total.

    A delay must be longer than what sampling explains.
    """
    arm, terms = linearisation.arm, linearisation.terms
    lowest = np.full(terms.size, -np.inf)
    believed = {"coulomb_friction": arm.coulomb, "viscous_friction": arm.viscous, "armature": arm.armature}
    for effect in terms.joint_effects:
        block = terms.block(effect)
        lowest[block] = effect.parameters[0].bounds[0]
        if effect.name in believed:
            lowest[block] = -believed[effect.name] - 1e-9
        if effect.name == "actuator_delay":
            lowest[block] = LEAST_DELAY
    lowest[terms.payload[0]] = -linearisation.body.inertial_parameters()[10 * linearisation.body.last_link]
    return lowest


def best_evidence(linearisation: Linearisation, unseen: np.ndarray, terms: frozenset[Term]) -> Evidence:
    """The evidence under the skew, then the error of the nominal inertials, that explain the data best."""

    def best(candidates: list[Evidence]) -> Evidence:
        return max(candidates, key=lambda evidence: evidence.fit(terms).score)

    skew = best([Evidence(linearisation, unseen, NOMINAL_ERROR[1], skew) for skew in SKEWS]).skew
    return best([Evidence(linearisation, unseen, sigma, skew) for sigma in NOMINAL_ERROR])
