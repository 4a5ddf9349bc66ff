"""Evidence for a set of terms: how well it predicts data that it was not fitted to, less what it costs.

Score of a set S, in nats, over folds f (half a recording left out each) and joints j:

    score = -(1 + nu)/2 sum_fj n_fj log(1 + mse_fj / e_fj^2) - charge(S) - 1/2 (delta^T Q delta + log det)

with n the effective number of samples, mse the mean square of the held-out gap, e what a healthy arm leaves (noise, or
the discrepancy learnt from the data). This is the likelihood of Gaussian errors whose unknown variance is integrated
out: a reference tells it, e^2, as well as the n samples do (nu = 1), without one it is learnt from these themselves
(nu = 0). delta are the errors of the nominal inertials, or of an arm identified on a
reference, a nuisance of every model with the prior precision Q. A second nuisance is the skew
between torque and motion that sampling leaves, the same on all joints: a torque held from one tick of the controller to
the next acts half a tick late on average.

With joint torque sensors j runs over both sides of each joint (``gapscope/diagnosis/model/torque_sensor.py``), and
the errors of the sensors are a third nuisance.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import chi2

from gapscope.diagnosis.model.linearisation import Linearisation
from gapscope.diagnosis.model.normal_equations import NormalEquations, solve_positive
from gapscope.diagnosis.selection.coordinate_limits import (
    lowest_values,
    stated_bounds,
    usual_sizes,
)
from gapscope.diagnosis.selection.fold_equations import FoldEquations, mean_squares
from gapscope.diagnosis.thresholds import (
    NEW_EFFECT,
    PRIOR_EXPONENT,
    SKEW_CHARGE,
    SKEWS,
    UNLIKELY_ERRORS,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.terms import (
    Term,
    cost,
    count_findings,
)

FEWEST_AT_ONCE = 8
"""Sets of terms of one size from which on it pays to fit them at once."""


@dataclass(frozen=True)
class Fit:
    """A set of terms fitted.

    Attributes:
        terms: the set.
        score: evidence [nats].
        cost: what was taken off the likelihood for terms, nuisances and skew [nats].
        theta: values fitted to all folds, shape (P,).
        held_out_mse: mean square of the gap per fold and joint, each fold predicted from the others [N^2 m^2], (F, n).
        scored_mse: the same of the rows that were scored, (F, m): joints, or with sensors both sides of them.
        impossible: terms whose values cannot be; the score is minus infinity if there are any.
    """

    terms: frozenset[Term]
    score: float
    cost: float
    theta: np.ndarray
    held_out_mse: np.ndarray
    scored_mse: np.ndarray
    impossible: frozenset[Term] = frozenset()


class Evidence:
    """Scores sets of terms on one linearisation.

    Args:
        linearisation: normal equations per fold and joint.
        scored_mse: mean square of the scored rows under the model so far, for the weights, (F, m).
        level: of the nuisances' prior: relative error of the nominal inertials, or a factor on what a reference says.
        torque: equations of the recorded torque, in which gaps are measured.
        scored: equations that values and scores come from: ``torque`` itself, or with joint torque sensors those of
            both sides of each joint.

    Attributes:
        weights: of the scored rows [1/(N m)^2], (F, m): independent samples per row over the expected mean square.
        prior: precision of the nuisances, in their units, (K, K).
        lowest: lowest value that each coordinate may have, (P,).
        bounds: value at which each coordinate stops, (P,).
    """

    def __init__(
        self,
        linearisation: Linearisation,
        scored_mse: np.ndarray,
        level: float,
        torque: FoldEquations,
        scored: FoldEquations,
    ) -> None:
        self.linear, self.level = linearisation, level
        self.torque, self.scored = torque, scored
        self.terms = linearisation.terms
        self.lowest = lowest_values(linearisation.arm, linearisation.body, self.terms)
        self.bounds = stated_bounds(linearisation.arm, self.terms)
        samples_per_row = scored.independent / np.maximum(scored.count, 1e-9)
        self.weights = samples_per_row / (scored_mse + scored.expected2)
        self.prior = linearisation.data.prior.at(level)
        last = linearisation.body.last_link + 1
        self._loads = frozenset(t for t in self.terms.all if t.is_load)
        self._last_link = {t for t in self.terms.all if t.changes_link(last)}
        self._usual = usual_sizes(linearisation.data.arm, self.terms)
        self._all, self._without_fold = scored.normals(
            self.weights, self.terms.size, self.prior, self.bounds
        )
        self._log_det = self._occam_factor()
        # as in BIC: half the logarithm of the number of samples for each parameter
        self._per_parameter = 0.5 * float(np.log(scored.independent.sum()))

    @property
    def skew(self) -> float:
        """Skew of sampling [s]."""
        return self.torque.skew

    @property
    def inertial_error(self) -> float:
        """Relative error of the nominal inertials that is allowed for [1]."""
        return self.level

    @property
    def sensed(self) -> bool:
        """Whether joint torque sensors are scored, and their errors are nuisances."""
        return self.scored is not self.torque

    @property
    def rows(self) -> np.ndarray:
        """Weight of the rows of the recorded torque, (F, n)."""
        return self.torque.count

    @property
    def floor2(self) -> np.ndarray:
        """Mean square of a healthy arm's torque gap [N^2 m^2], (F, n)."""
        return self.torque.floor2

    @property
    def expected2(self) -> np.ndarray:
        """Mean square of the torque gap that a healthy arm leaves of every model [N^2 m^2], (F, n)."""
        return self.torque.expected2

    def normal_equations(self, total: np.ndarray) -> NormalEquations:
        """Normal equations with the nuisances' prior from weighted X^T X, (P + K + 1, P + K + 1), or F."""
        return NormalEquations(total, self.terms.size, self.prior, self.bounds)

    def fit(self, terms: frozenset[Term]) -> Fit:
        """Fit and score a set of terms; the score is minus infinity if a value could not be."""
        columns = columns_of(terms)
        held_out_mse = self.held_out_mse(terms)
        scored_mse = held_out_mse
        if self.sensed:
            scored_mse = self.scored.mean_square(
                self._without_fold, columns, corrected=True
            )
        return self._fit(terms, self._all.solve(columns), held_out_mse, scored_mse)

    def fits(self, sets: Sequence[frozenset[Term]]) -> list[Fit]:
        """Fits of many sets of terms, at a fraction of what each costs alone."""
        by_size: dict[int, list[frozenset[Term]]] = {}
        for terms in sets:
            by_size.setdefault(len(columns_of(terms)), []).append(terms)
        found = dict[frozenset[Term], Fit]()
        for size, alike in by_size.items():
            many = size > 0 and len(alike) >= FEWEST_AT_ONCE
            for fit in self._at_once(alike) if many else map(self.fit, alike):
                found[fit.terms] = fit
        return [found[terms] for terms in sets]

    def _at_once(self, sets: Sequence[frozenset[Term]]) -> Iterator[Fit]:
        """Fits of sets of terms with one number of coordinates."""
        columns = np.array([columns_of(terms) for terms in sets])
        values = self._all.solve_each(columns)
        without = self._without_fold.solve_each(columns)
        reduced = self._reduced
        held_out = mean_squares(reduced[0], without, self.torque.count)
        scored = held_out
        if self.sensed:
            scored = mean_squares(reduced[1], without, self.scored.count)
        for terms, theta, mse, mse_scored in zip(
            sets, values, held_out, scored, strict=True
        ):
            yield self._fit(terms, theta, mse, mse_scored)

    @cached_property
    def _reduced(self) -> list[np.ndarray]:
        """Equations of each fold with the nuisances fitted without it, of the recorded torque and of what is scored."""
        equations = [self.torque, self.scored] if self.sensed else [self.torque]
        return [self._without_fold.reduced(one.gram, one.skew) for one in equations]

    def _fit(
        self,
        terms: frozenset[Term],
        theta: np.ndarray,
        held_out_mse: np.ndarray,
        scored_mse: np.ndarray,
    ) -> Fit:
        """The fit of a set of terms with values theta, (P,), and what these leave of each fold, (F, n) and (F, m)."""
        columns = columns_of(terms)
        cost = self._cost(terms, theta, self._all.nuisance(theta, columns))
        relative = np.log1p(scored_mse / self.scored.expected2)
        misfit = float((self.scored.independent * relative).sum())
        score = -misfit / 2 - cost
        impossible = self._impossible(theta, terms)
        return Fit(
            terms,
            -np.inf if impossible else score,
            cost,
            theta,
            held_out_mse,
            scored_mse,
            impossible,
        )

    def fit_possible(self, terms: frozenset[Term]) -> Fit:
        """Fit of a set of terms, less those whose values are impossible."""
        fit = self.fit(terms)
        while fit.impossible:
            fit = self.fit(fit.terms - fit.impossible)
        return fit

    def charge(self, terms: frozenset[Term]) -> float:
        """What a set costs [nats]: half the logarithm of the samples per parameter, and so much per effect named."""
        return self._per_parameter * cost(terms) + NEW_EFFECT * count_findings(terms)

    def held_out_mse(
        self, terms: frozenset[Term], *, corrected: bool = True
    ) -> np.ndarray:
        """Mean square of the gap on each fold under values fitted to the others [N^2 m^2], (F, n).

        ``corrected`` says whether the nuisances, errors of the nominal inertials and skew, are taken out as well.
        """
        return self.torque.mean_square(
            self._without_fold, columns_of(terms), corrected=corrected
        )

    def likely_mse(self, terms: frozenset[Term]) -> np.ndarray:
        """``held_out_mse`` with the nuisances taken out as far as they are likely [N^2 m^2], (F, n).

        Errors delta of a data sheet whose delta^T Q delta exceeds ``UNLIKELY_ERRORS`` of chi2 with as many degrees of
        freedom as the data tell of them are taken out by a share s that does not: (1 - s)^2 of what they explain stays.
        """
        plain = self.held_out_mse(terms, corrected=False)
        corrected = self.held_out_mse(terms, corrected=True)
        remaining = (1.0 - self._likely_share(terms)) ** 2
        return corrected + remaining * np.maximum(plain - corrected, 0.0)

    def _likely_share(self, terms: frozenset[Term]) -> float:
        """Share of the nuisances that a data sheet's errors can have [1]."""
        delta = self.nuisances(terms)
        told = solve_positive(self._all.nuisance_precision, self.prior)
        freedom = max(len(delta) - float(np.trace(told)), 1.0)
        most = float(chi2.isf(UNLIKELY_ERRORS, freedom))
        squared = float(delta @ self.prior @ delta)
        return min(1.0, float(np.sqrt(most / max(squared, 1e-12))))

    def in_sample_mse(
        self, terms: frozenset[Term], *, corrected: bool = True
    ) -> np.ndarray:
        """Mean square of the gap on each fold under values fitted to all folds [N^2 m^2], (F, n)."""
        return self.torque.mean_square(
            self._all, columns_of(terms), corrected=corrected
        )

    def without_last(self, terms: frozenset[Term]) -> np.ndarray:
        """Values of the terms fitted without the last recording, shape (P,)."""
        by_fold = self.scored.weighed(self.weights)
        # a recording is two folds; a single one cannot be left out
        kept = by_fold[:-2] if len(by_fold) > 2 else by_fold
        return self.normal_equations(kept.sum(axis=0)).solve(columns_of(terms))

    def left_out(self, terms: frozenset[Term]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Per recording the values of the terms fitted without its first, and without its second half, (P,) each."""
        values = self._without_fold.solve(columns_of(terms))
        return list(zip(values[::2], values[1::2], strict=True))

    def nuisances(self, terms: frozenset[Term]) -> np.ndarray:
        """Likeliest nuisances with a set of terms, (K,)."""
        columns = columns_of(terms)
        return self._all.nuisance(self._all.solve(columns), columns)

    def sensor_errors(self, terms: frozenset[Term]) -> np.ndarray | None:
        """Zero, scale and lag of each joint's torque sensor with a set of terms, over their spread, (3 n,)."""
        if not self.sensed:
            return None
        return self.nuisances(terms)[len(self.linear.data.units) :]

    def _occam_factor(self) -> float:
        """1/2 log det(1 + Q^-1 N^T W N): the nuisances' prior volume over the posterior one [nats]."""
        posterior = np.linalg.slogdet(self._all.nuisance_precision)[1]
        return 0.5 * float(posterior - np.linalg.slogdet(self.prior)[1])

    def _cost(
        self, terms: frozenset[Term], theta: np.ndarray, delta: np.ndarray
    ) -> float:
        """Charges of a set, of its values theta, (P,), and of its nuisances delta, (K,), [nats]."""
        charges = (
            self.charge(terms)
            + SKEW_CHARGE * (self.skew > 0)
            + self.linear.data.prior.levels[self.level]
        )
        columns = columns_of(terms)
        squared = (theta[columns] / self._usual[columns]) ** 2
        unusual = float(np.log1p(0.5 * squared / PRIOR_EXPONENT).sum())
        prior = 0.5 * float(delta @ self.prior @ delta)
        return charges + PRIOR_EXPONENT * unusual + (prior + self._log_det)

    def _impossible(self, theta: np.ndarray, terms: frozenset[Term]) -> frozenset[Term]:
        """Terms whose values cannot be, or that say the same as others of the set."""
        impossible = self.terms.impossible(theta, terms, self.lowest)
        loads = self._loads & terms
        # a load is part of the last link
        if loads and self._last_link & terms:
            impossible |= loads
        if any(theta[t.columns[0]] < 0 for t in loads):
            laden = CorrectedArm(self.linear.arm, self.terms.effects(theta, loads))
            if laden.feeds_energy(self.linear.body):
                impossible |= loads
        return impossible


def columns_of(terms: Iterable[Term]) -> np.ndarray:
    """Places of terms in theta, in order, shape (C,)."""
    return np.array(sorted(c for t in terms for c in t.columns), dtype=int)


def evidences(
    linearisation: Linearisation, scored_mse: np.ndarray, terms: frozenset[Term]
) -> tuple[Evidence, ...]:
    """The evidence at each level of the nuisances' prior, best first, with the skew that explains the data best.

    Args:
        linearisation: normal equations per fold and joint.
        scored_mse: mean square of the scored rows under the model so far, for the weights, (F, m).
        terms: the set by which they are compared.
    """

    def score(evidence: Evidence) -> float:
        return evidence.fit(terms).score

    torque, scored = _equations(linearisation)
    levels = list(linearisation.data.prior.levels)
    # the second level suits most arms: skews are compared under it
    first = levels[1]
    by_skew = [
        Evidence(linearisation, scored_mse, first, *_at(torque, scored, skew))
        for skew in SKEWS
    ]
    best = max(by_skew, key=score)
    others = [
        Evidence(linearisation, scored_mse, level, best.torque, best.scored)
        for level in levels
        if level != first
    ]
    return tuple(sorted([best, *others], key=score, reverse=True))


def _equations(
    linearisation: Linearisation,
) -> tuple[FoldEquations, FoldEquations]:
    """Equations of the recorded torque, and those that are scored: the same without sensors."""
    healthy = linearisation.discrepancy
    torque = FoldEquations(linearisation.folds, healthy)
    if not linearisation.data.sensed:
        return torque, torque
    sides = [fold.scored for fold in linearisation.folds]
    return torque, FoldEquations(sides, healthy)


def _at(
    torque: FoldEquations, scored: FoldEquations, skew: float
) -> tuple[FoldEquations, FoldEquations]:
    """Both at a skew of sampling [s]."""
    skewed = torque.at(skew)
    return skewed, skewed if scored is torque else scored.at(skew)
