"""The evidence of a set of effects, from folds of equations, with draws of its values."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.model.fit_data import Discrepancy, Fold
from gapscope.diagnosis.model.linearisation import Linearisation
from gapscope.diagnosis.model.normal_equations import (
    NormalEquations,
    Posterior,
    drawn,
    posteriors,
    solve_positive,
    with_skew,
)
from gapscope.diagnosis.thresholds import (
    EFFECT_FORM,
    GAIN_ERROR,
    LINK_CHANGE,
    MODEL_FORM,
    SKEW_CHARGE,
    SKEWS,
    UNLIKELY_ERRORS,
    VALUE_DRAWS,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import External, Inertial, Sensing
from gapscope.model.terms import Term, Terms, cost

# How small the coordinates of terms may be, where they stop, and how large they usually are.


def lowest_values(arm: NominalArm, body: RigidBody, terms: Terms) -> np.ndarray:
    """Lowest values, (P,): as the effects say; what adds to the data sheet may not fall below zero in total."""
    lowest = np.full(terms.size, -np.inf)
    masses = body.inertial_parameters()[::10]
    for effect in terms.definitions:
        fitted, places = effect.fitted, terms.block(effect.name)[0]
        least = fitted.lowest
        lowest[places] = least(masses, body.last_link) if callable(least) else least
        if fitted.data_sheet is not None:
            lowest[places] = -getattr(arm, fitted.data_sheet) - 1e-9
    return lowest


def stated_bounds(arm: NominalArm, terms: Terms) -> np.ndarray:
    """Lower bounds at which values stop, (P,): what the data sheet or the URDF states may be gone altogether.

    Others have none: a value that cannot be speaks against its term, the absence of what is stated does not.
    """
    bounds = np.full(terms.size, -np.inf)
    for effect in terms.definitions:
        stated = effect.fitted.data_sheet
        if stated is not None:
            nominal = getattr(arm, stated)
            places = terms.block(effect.name)[0]
            bounds[places] = np.where(nominal > 0, -nominal, -np.inf)
    return bounds


# Normal equations of the folds at one skew of sampling, as the evidence reads them.


class FoldEquations:
    """Normal equations of F folds with m rows each, at one skew of sampling.

    Attributes:
        skew: the skew [s].
        gram: X^T W X of X = [A, N, y, d], (F, m, P + K + 2, P + K + 2), the same at any skew.
        count: weight of the rows, (F, m).
        floor2: mean square of a healthy arm [N^2 m^2], (F, m).
        independent: effective number of independent samples, (F, m).
        expected2: mean square that a model is expected to leave, the floor's or the discrepancy's [N^2 m^2], (F, m).
    """

    def __init__(
        self, folds: Sequence[Fold], healthy: Discrepancy, skew: float = 0.0
    ) -> None:
        self.skew = skew
        self.gram = np.array([fold.total for fold in folds])
        self.count = np.array([fold.count for fold in folds])
        self.floor2 = np.array([fold.floor for fold in folds]) ** 2
        joints = self.floor2.shape[1]
        self.independent = self.count / healthy.inflation[:joints]
        self.expected2 = np.maximum(self.floor2, healthy.mean_square[:joints])
        self._weighed: dict[bytes, np.ndarray] = {}
        self._eliminated: dict[bytes, tuple[NormalEquations, NormalEquations]] = {}

    def at(self, skew: float) -> FoldEquations:
        """The same at another skew [s]."""
        other = copy(self)
        other.skew = skew
        return other

    def weighed(self, weights: np.ndarray) -> np.ndarray:
        """X^T W X of X = [A, N, y - skew d] of each fold, its rows weighed by (F, m): (F, P + K + 1, P + K + 1)."""
        return with_skew(self._weighed_at(weights), self.skew)

    def normals(
        self,
        weights: np.ndarray,
        size: int,
        prior: np.ndarray,
        bounds: np.ndarray | None = None,
    ) -> tuple[NormalEquations, NormalEquations]:
        """Normal equations of all folds, and of all but each, their rows weighed by (F, m).

        Args:
            weights: of the rows.
            size, prior, bounds: see ``NormalEquations``.
        """
        key = weights.tobytes() + prior.tobytes()
        if key not in self._eliminated:
            by_fold = self._weighed_at(weights)
            total = by_fold.sum(axis=0)
            # at every skew the nuisances are eliminated alike
            self._eliminated.clear()
            self._eliminated[key] = (
                NormalEquations(total, size, prior, bounds),
                NormalEquations(total - by_fold, size, prior, bounds),
            )
        whole, without = self._eliminated[key]
        return whole.at(self.skew), without.at(self.skew)

    def _weighed_at(self, weights: np.ndarray) -> np.ndarray:
        """X^T W X of X = [A, N, y, d] of each fold; the same weights are asked for at every skew."""
        key = weights.tobytes()
        if key not in self._weighed:
            self._weighed.clear()
            pairs = zip(weights, self.gram, strict=True)
            sums = [np.tensordot(own, gram, axes=1) for own, gram in pairs]
            self._weighed[key] = np.array(sums)
        return self._weighed[key]

    def mean_square(
        self,
        normals: NormalEquations,
        columns: np.ndarray,
        *,
        corrected: bool,
    ) -> np.ndarray:
        """Mean square of the residual of each fold [N^2 m^2], (F, m).

        Args:
            normals: the equations that the values come from, of each fold its own or one for all.
            columns: places of the terms that are fitted.
            corrected: whether nuisances and skew are taken out of the residual.
        """
        theta = normals.solve(columns)
        skew = self.skew if corrected else 0.0
        squares = normals.rest(self.gram, theta, columns, skew, corrected=corrected)
        return squares / np.maximum(self.count, 1e-9)


# Evidence for a set of terms: how well it predicts data that it was not fitted to, less what it costs.
#
# Score of a set S, in nats, over folds f (half a recording left out each) and joints j:
#
#     score = -(1 + nu)/2 sum_fj n_fj log(1 + mse_fj / e_fj^2) - charge(S) - 1/2 (delta^T Q delta + log det)
#
# with n the effective number of samples, mse the mean square of the held-out gap, e what a healthy arm leaves (noise,
# or the discrepancy learnt from the data). This is the likelihood of Gaussian errors whose unknown variance is
# integrated out: a reference tells it, e^2, as well as the n samples do (nu = 1), without one it is learnt from these
# themselves (nu = 0). delta are the errors of the nominal inertials, or of an arm identified on a reference, a
# nuisance of every model with the prior precision Q. A second nuisance is the skew between torque and motion that
# sampling leaves, the same on all joints: a torque held from one tick of the controller to the next acts half a tick
# late on average.
#
# With joint torque sensors j runs over both sides of each joint (``gapscope/diagnosis/model/linearisation.py``), and
# the errors of the sensors are a third nuisance.


@dataclass(frozen=True)
class Fit:
    """A set of terms fitted.

    Attributes:
        terms: the set.
        score: evidence [nats].
        theta: values fitted to all folds, shape (P,).
        held_out_mse: mean square of the gap per fold and joint, each fold predicted from the others [N^2 m^2], (F, n).
        scored_mse: the same of the rows that were scored, (F, m): joints, or with sensors both sides of them.
        infeasible: terms whose values cannot be; the score is minus infinity if there are any.
    """

    terms: frozenset[Term]
    score: float
    theta: np.ndarray
    held_out_mse: np.ndarray
    scored_mse: np.ndarray
    infeasible: frozenset[Term] = frozenset()


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
        together, without_fold: normal equations of all folds, and of all but each.
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
        self.together, self.without_fold = scored.normals(
            self.weights, self.terms.size, self.prior, self.bounds
        )
        self._log_det = self._occam_factor()
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
                self.without_fold, columns, corrected=True
            )
        theta = self.together.solve(columns)
        charge = self._cost(terms, self.together.nuisance(theta, columns))
        relative = np.log1p(scored_mse / self.scored.expected2)
        misfit = float((self.scored.independent * relative).sum())
        score = -misfit / 2 - charge
        impossible = self._impossible(theta, terms)
        return Fit(
            terms,
            -np.inf if impossible else score,
            theta,
            held_out_mse,
            scored_mse,
            impossible,
        )

    def fit_possible(self, terms: frozenset[Term]) -> Fit:
        """Fit of a set of terms, less those whose values are impossible."""
        fit = self.fit(terms)
        while fit.infeasible:
            fit = self.fit(fit.terms - fit.infeasible)
        return fit

    def held_out_mse(
        self, terms: frozenset[Term], *, corrected: bool = True
    ) -> np.ndarray:
        """Mean square of the gap on each fold under values fitted to the others [N^2 m^2], (F, n).

        ``corrected`` says whether the nuisances, errors of the nominal inertials and skew, are taken out as well.
        """
        return self.torque.mean_square(
            self.without_fold, columns_of(terms), corrected=corrected
        )

    def mse_plausible_inertials(self, terms: frozenset[Term]) -> np.ndarray:
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
        told = solve_positive(self.together.nuisance_precision, self.prior)
        freedom = max(len(delta) - float(np.trace(told)), 1.0)
        most = float(chi2.isf(UNLIKELY_ERRORS, freedom))
        squared = float(delta @ self.prior @ delta)
        return min(1.0, float(np.sqrt(most / max(squared, 1e-12))))

    def without_last(self, terms: frozenset[Term]) -> np.ndarray:
        """Values of the terms fitted without the last recording, shape (P,)."""
        by_fold = self.scored.weighed(self.weights)
        # a recording is two folds; a single one cannot be left out
        kept = by_fold[:-2] if len(by_fold) > 2 else by_fold
        return self.normal_equations(kept.sum(axis=0)).solve(columns_of(terms))

    def left_out(self, terms: frozenset[Term]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Per recording the values of the terms fitted without its first, and without its second half, (P,) each."""
        values = self.without_fold.solve(columns_of(terms))
        return list(zip(values[::2], values[1::2], strict=True))

    def nuisances(self, terms: frozenset[Term]) -> np.ndarray:
        """Likeliest nuisances with a set of terms, (K,)."""
        columns = columns_of(terms)
        return self.together.nuisance(self.together.solve(columns), columns)

    def sensor_errors(self, terms: frozenset[Term]) -> np.ndarray | None:
        """Zero, scale and lag of each joint's torque sensor with a set of terms, over their spread, (3 n,)."""
        if not self.sensed:
            return None
        return self.nuisances(terms)[len(self.linear.data.units) :]

    def _occam_factor(self) -> float:
        """1/2 log det(1 + Q^-1 N^T W N): the nuisances' prior volume over the posterior one [nats]."""
        posterior = np.linalg.slogdet(self.together.nuisance_precision)[1]
        return 0.5 * float(posterior - np.linalg.slogdet(self.prior)[1])

    def _cost(self, terms: frozenset[Term], delta: np.ndarray) -> float:
        """What a set costs [nats]: half the logarithm of the samples per parameter, as in BIC, and its nuisances."""
        parameters = self._per_parameter * cost(terms)
        nuisances = (
            SKEW_CHARGE * (self.skew > 0) + self.linear.data.prior.levels[self.level]
        )
        prior = 0.5 * float(delta @ self.prior @ delta)
        return parameters + nuisances + (prior + self._log_det)

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


def likeliest_evidence(
    linearisation: Linearisation, scored_mse: np.ndarray, terms: frozenset[Term]
) -> Evidence:
    """The evidence at the level of the nuisances' prior and with the skew that explain the data best.

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
    others = (
        Evidence(linearisation, scored_mse, level, best.torque, best.scored)
        for level in levels
        if level != first
    )
    return max(best, *others, key=score)


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


# Pieces of the data divided in two: what one half says of the values, and the other of them.


def alternate_pieces(evidence: Evidence) -> tuple[np.ndarray, np.ndarray]:
    """Weighted normal equations of every other piece of the data, and of those between."""
    pieces = _pieces(evidence)
    return pieces[::2].sum(axis=0), pieces[1::2].sum(axis=0)


def _pieces(evidence: Evidence) -> np.ndarray:
    """Weighted normal equations of every piece of the data, (pieces, C, C)."""
    # the last column is that of the skew, which is taken out of y
    columns = np.arange(evidence.scored.gram.shape[-1])
    out = []
    for fold, weights in zip(evidence.linear.folds, evidence.weights, strict=True):
        gram = with_skew(fold.scored.by_piece(columns), evidence.skew)
        out.append(np.einsum("bjxy,j->bxy", gram, weights))
    return np.concatenate(out)


# Draws of the values of a set of terms, from which their intervals follow.
#
# Values are drawn beside errors of the nominal arm, of the sensors or of a reference whose size the data tell
# (``gapscope/diagnosis/model/normal_equations.py``), with the weights of the evidence: independent samples over the
# square of what a healthy arm leaves. Beside a data sheet, the gain by which each joint's torque is recorded is off
# as well, unless its scale is among the terms. A changed link is an error of the nominal arm too: if one was named,
# the values of all other terms are drawn with it and without it, as likely as the data make either.
#
# Added to each draw is
#
# - what values fitted without one half of a recording after the other scatter beyond it, by Student's t of the
#   number of halves [kunsch1989];
# - what the form of the model, wrong by ``MODEL_FORM``, may shift a value by, were half of it proportional to the
#   term's own column;
# - for laws whose form in nature differs, half of ``EFFECT_FORM`` of the value.


EXACT = (Inertial, External, Sensing)
"""Kinds of effects whose form is that of mechanics."""


def value_draws(
    evidence: Evidence,
    terms: frozenset[Term],
    rng: np.random.Generator,
    count: int = VALUE_DRAWS,
) -> np.ndarray:
    """Values of the terms as likely as the data make them, zeros elsewhere, (count, P)."""
    unseen, size = evidence.linear.data.prior.sizes.unseen, evidence.terms.size
    found = _posteriors(evidence, terms)
    values = drawn([found], unseen, size, rng, count)
    linked = frozenset(t for t in terms if t.definition.scope == "link")
    if linked:
        links = columns_of(linked)
        changes = values[:, links]
        either = [found, _posteriors(evidence, terms - linked)]
        values = drawn(either, unseen, size, rng, count)
        values[:, links] = changes
    columns = columns_of(terms)
    values[:, columns] += _scatter(evidence, terms, values[:, columns], rng)
    values += rng.normal(size=values.shape) * _form_of_model(evidence)
    values *= _forms_of_effects(terms, rng, values.shape)
    out = np.zeros_like(values)
    # gains were drawn beside the terms
    out[:, columns] = np.maximum(values, evidence.bounds)[:, columns]
    return out


def _posteriors(evidence: Evidence, terms: frozenset[Term]) -> list[Posterior]:
    """The values of a set of terms, and of gains, under every size that the errors of the nominal arm may have."""
    total = evidence.scored.weighed(evidence.weights).sum(axis=0)
    precision = _precision(evidence, terms)
    columns = np.union1d(columns_of(terms), np.flatnonzero(precision))
    return posteriors(total, columns, precision, evidence.linear.data.prior.sizes)


def _precision(evidence: Evidence, terms: frozenset[Term]) -> np.ndarray:
    """Prior precision of the coordinates, (P,): of changed links that of ``LINK_CHANGE``, of gains, others are flat."""
    out = np.zeros(evidence.terms.size)
    gains = [
        t
        for t in evidence.terms.all
        if "scale" in t.definition.quantities.values() and t not in terms
    ]
    out[columns_of(gains)] = GAIN_ERROR**-2.0
    units = evidence.linear.data.units.reshape(-1, 10)
    for term in terms:
        if term.definition.scope == "link":
            mass, moment = units[term.joint - 1, :2]
            sizes = LINK_CHANGE * np.array([mass, *[moment / mass] * 3])
            out[list(term.columns)] = sizes**-2.0
    return out


def _scatter(
    evidence: Evidence,
    terms: frozenset[Term],
    values: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """What values scatter between halves of recordings beyond what draws of them, (D, C), do: (D, C)."""
    pairs = evidence.left_out(terms)
    without_half = np.array([half for pair in pairs for half in pair])
    halves = len(without_half)
    # of the jackknife
    variance = (halves - 1) * without_half[:, columns_of(terms)].var(axis=0)
    # draws of a value of which the data say nothing have a variance beyond all numbers
    with np.errstate(over="ignore"):
        excess = np.sqrt(np.maximum(variance - values.var(axis=0), 0.0))
    return np.asarray(rng.standard_t(halves - 1, size=values.shape) * excess)


def _form_of_model(evidence: Evidence) -> np.ndarray:
    """Standard deviation that the form of the model adds to each value, (P,)."""
    squares = np.diagonal(evidence.torque.gram, axis1=2, axis2=3)
    power = squares[:, :, : evidence.terms.size].sum(axis=0)
    column_rms = np.sqrt(power / evidence.rows.sum(axis=0)[:, None])
    torque = evidence.linear.data.torque_deviation[:, None]
    by_joint = 0.5 * MODEL_FORM * torque / np.maximum(column_rms, 1e-12)
    return np.asarray(by_joint.min(axis=0))


def _forms_of_effects(
    terms: frozenset[Term], rng: np.random.Generator, shape: tuple[int, ...]
) -> np.ndarray:
    """Factors on the values by which the forms of their laws differ from those in nature, (D, P)."""
    out = np.ones(shape)
    # in a fixed order, so that the same case has the same intervals
    for term in sorted(terms, key=lambda t: t.columns):
        if not isinstance(term.definition, EXACT):
            error = 0.5 * EFFECT_FORM * rng.normal(size=(shape[0], 1))
            out[:, list(term.columns)] += error
    return out
