"""What a model predicts of recordings that it was not fitted to: gaps, shares of effects, excess over the floor."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import factorial

import numpy as np
from scipy.stats import chi2

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.gap.noise_floor import noise_floor
from gapscope.diagnosis.model.normal_equations import NormalEquations, solve
from gapscope.diagnosis.selection.evidence import alternate_pieces
from gapscope.diagnosis.selection.fitted_model import Selection, by_finding
from gapscope.diagnosis.thresholds import (
    ABOVE_FLOOR_NRMSE,
    ABOVE_FLOOR_RATIO,
    EXPLAINED_RESIDUAL,
    EXPLAINED_RESIDUAL_COMPLIANT,
    FALSE_ALARM_RATE,
    LOUDEST_FLOOR,
    RESIDUAL_ABOVE_FLOOR_RATIO,
    VISIBLE_EFFECT,
    WIDE_RESIDUAL_NRMSE,
    WIDE_RESIDUAL_SHARE,
)
from gapscope.effects.catalogue import explained
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import Segment
from gapscope.model.terms import Term
from gapscope.model.torque_gap import TorqueGap, torque_gap, torque_scale

# The excess residual: what exceeds the noise floor once the effects found are added.
#
# Measured on held-out data with the errors of the nominal inertials taken out. Rows on which a joint may stick count by
# how well dry friction is known there, so that an arm at rest for long does not dilute the residual.


@dataclass(frozen=True)
class ExcessResidual:
    """What is above the floor per joint, n joints.

    Attributes:
        before: torque NRMSE of the nominal arm above the floor, in squares: sqrt(gap^2 - floor^2) / scale, (n,).
        after: the same with the effects found, (n,).
        ratio: RMS with the effects found over the floor's, (n,).
        ratio_expected: RMS with the effects found over what a healthy arm leaves of every model, (n,).
        by_chance: ratio that chance exceeds on any joint at the false-alarm rate, (n,).
        compliant: whether a compliant joint is among the effects found.
    """

    before: np.ndarray
    after: np.ndarray
    ratio: np.ndarray
    ratio_expected: np.ndarray
    by_chance: np.ndarray
    compliant: bool

    @property
    def above(self) -> np.ndarray:
        """Joints above the floor, (n,)."""
        improved = self.before > self.after + 1e-9
        least = np.where(improved, RESIDUAL_ABOVE_FLOOR_RATIO, ABOVE_FLOOR_RATIO)
        least = np.maximum(least, self.by_chance)
        return (self.ratio > least) & (self.after > ABOVE_FLOOR_NRMSE)

    @property
    def open(self) -> bool:
        """Whether the effects found leave too much of the gap."""
        return self.exceeds_explained_share_of(self.before)

    def exceeds_explained_share_of(self, before: np.ndarray) -> bool:
        """Whether the residual exceeds what effects may leave of a torque NRMSE above the floor, (n,)."""
        residual = (self.after[self.above] ** 2).sum()
        share = EXPLAINED_RESIDUAL_COMPLIANT if self.compliant else EXPLAINED_RESIDUAL
        too_much = residual > share * (before**2).sum()

        # One joint that keeps most of its gap is unexplained, even if it is a small part of the whole.
        least_wide = np.maximum(WIDE_RESIDUAL_NRMSE, WIDE_RESIDUAL_SHARE * before)
        wide = self.above & (self.after > least_wide)
        return bool(too_much or wide.any())


def elementwise_max(one: ExcessResidual, other: ExcessResidual) -> ExcessResidual:
    """The larger of two excess residuals on each joint."""
    return ExcessResidual(
        before=np.maximum(one.before, other.before),
        after=np.maximum(one.after, other.after),
        ratio=np.maximum(one.ratio, other.ratio),
        ratio_expected=np.maximum(one.ratio_expected, other.ratio_expected),
        by_chance=np.maximum(one.by_chance, other.by_chance),
        compliant=one.compliant,
    )


def excess_residual(selection: Selection, gap: np.ndarray) -> ExcessResidual:
    """What is above the floor before and after the effects found, on the folds.

    The gap is measured twice: by the evidence, on the decimated rows of the search with the effects linearised, and
    by ``torque_gap`` at the full rate. The smaller counts, because an effect that is far from linear is predicted
    badly by its linearisation. The other place that reconciles both is the floor in ``study``.

    Args:
        selection: result of the search.
        gap: RMS of the gap with the effects found on all held-out rows, at the full rate [N m], (n,).
    """
    evidence, terms = selection.evidence, selection.fit.terms
    rows = evidence.rows
    count = rows.sum(axis=0)

    def pooled(mean_square: np.ndarray) -> np.ndarray:
        """Mean square over all folds, (n,), of those per fold, (F, n)."""
        return np.asarray((mean_square * rows).sum(axis=0) / count)

    # Mean squares [N^2 m^2], (n,).
    before2 = pooled(selection.nominal_mse)
    after2 = np.minimum(pooled(evidence.mse_plausible_inertials(terms)), gap**2)
    floor2 = pooled(evidence.floor2)

    expected2 = pooled(evidence.expected2)

    # If even the quietest joint is above its floor, the floors are too low rather than all joints wrong.
    loudness2 = np.clip((after2 / floor2).min(), 1.0, LOUDEST_FLOOR**2)
    floor2 = floor2 * loudness2

    above_before = np.sqrt(np.clip(before2 - floor2, 0.0, None))
    above_after = np.sqrt(np.clip(after2 - floor2, 0.0, None))
    return ExcessResidual(
        before=above_before / selection.scale,
        after=above_after / selection.scale,
        ratio=np.sqrt(after2 / floor2),
        ratio_expected=np.sqrt(after2 / np.maximum(floor2, expected2)),
        by_chance=ratio_by_chance(selection),
        compliant=_has_compliance(selection),
    )


def excess_residual_set_aside(
    selection: Selection, before: TorqueGap, after: TorqueGap, floor: np.ndarray
) -> ExcessResidual:
    """What is above the floor [N m], (n,), on recordings that are never fitted."""
    scale = torque_scale(before.measured)
    healthy = np.sqrt(selection.evidence.expected2.mean(axis=0))

    def above_floor(gap: TorqueGap) -> np.ndarray:
        excess2 = np.clip(gap.rmse**2 - floor**2, 0.0, None)
        return np.asarray(np.sqrt(excess2) / scale)

    return ExcessResidual(
        before=above_floor(before),
        after=above_floor(after),
        ratio=after.rmse / floor,
        ratio_expected=after.rmse / np.maximum(floor, healthy),
        by_chance=ratio_by_chance(selection),
        compliant=_has_compliance(selection),
    )


def ratio_by_chance(selection: Selection) -> np.ndarray:
    """Ratio of RMS to floor that healthy arms exceed on one of n joints in ``FALSE_ALARM_RATE`` of cases, (n,).

    Of independent samples with the floor's variance: the root of a quantile of chi2 over its degrees of freedom.
    Source: bendat2010.
    """
    evidence = selection.evidence
    joints = evidence.linear.arm.n_joints
    samples = evidence.scored.independent.sum(axis=0)[:joints]
    level = FALSE_ALARM_RATE / joints
    return np.asarray(np.sqrt(chi2.isf(level, samples) / samples))


def _has_compliance(selection: Selection) -> bool:
    return any(not term.definition.locally_linear for term in selection.fit.terms)


# How far: the gap of sets of terms on data that they were not fitted to, and the share of each effect.


SHARE_DRAWS = 200
"""Draws of folds behind the interval of a share."""

GapOf = Callable[[CorrectedArm, list[Segment]], TorqueGap]
"""A gap of an arm on segments."""


@dataclass(frozen=True)
class HeldOutPredictor:
    """Predicts held-out data with sets of terms.

    Attributes:
        arm, body: the nominal arm and its dynamics.
        selection: result of the search.
        folds: segments per fold; each half of one is predicted with values fitted to its other half and to the
            other folds.
        set_aside: segments of recordings that are never fitted; if there are any, they alone are predicted, with
            values fitted to all folds.
    """

    arm: NominalArm
    body: RigidBody
    selection: Selection
    folds: list[list[Segment]]
    set_aside: list[Segment]
    _gaps: dict[frozenset[Term], TorqueGap] = field(default_factory=dict, repr=False)

    def of(self, selection: Selection) -> HeldOutPredictor:
        """The same with another result of the search."""
        # gaps that are known depend on the evidence that fits the values, not on the terms chosen
        same = selection.evidence is self.selection.evidence
        return replace(self, selection=selection, _gaps=self._gaps if same else {})

    @property
    def segments(self) -> list[Segment]:
        """The segments that are predicted."""
        return self.set_aside or [segment for fold in self.folds for segment in fold]

    def gap(self, terms: frozenset[Term]) -> TorqueGap:
        """Torque gap on held-out data of the nominal arm plus some of the terms, fitted anew."""
        if terms not in self._gaps:
            self._gaps[terms] = self.measured(
                terms, lambda arm, segments: torque_gap(arm, self.body, segments)
            )
        return self._gaps[terms]

    def measured(self, terms: frozenset[Term], gap_of: GapOf) -> TorqueGap:
        """Any gap on held-out data of the nominal arm plus some of the terms, fitted anew."""
        evidence = self.selection.evidence

        # Recordings that are never fitted are held out as they are: no fold has to be left out.
        if self.set_aside:
            corrected = self.selection.corrected(evidence.fit(terms).theta, terms)
            return gap_of(corrected, self.set_aside)

        gaps = []
        for values, fold in zip(evidence.left_out(terms), self.folds, strict=True):
            # The whole fold is predicted twice, as effects with a state need what came before.
            without_first = self.selection.corrected(values[0], terms)
            without_second = self.selection.corrected(values[1], terms)
            joined = join_halves(
                gap_of(without_first, fold), gap_of(without_second, fold)
            )
            gaps.append(joined)
        return _concatenated(gaps)

    def shares(self, draws: int = SHARE_DRAWS) -> dict[str, Share]:
        """Share of each effect in the gap closed, by Shapley's value over all orders of adding them.

        The worth of a set is the sum over joints of the held-out torque NRMSE that it closes; shares add up to the
        closed part of the gap above the floor, at most 1. Intervals are from folds drawn with replacement.
        """
        evidence, chosen = self.selection.evidence, self.selection.fit.terms
        names = sorted({t.finding for t in chosen})
        weights = _fold_weights(evidence.rows, draws)

        def total_nrmse(square: np.ndarray) -> np.ndarray:
            """NRMSE summed over joints, under each draw, (draws + 1,), of mean squares per fold and joint, (F, n)."""
            rows = np.maximum(weights.sum(axis=1), 1e-12)
            mean = (square * weights).sum(axis=1) / rows
            nrmse = np.sqrt(mean) / self.selection.scale
            return np.asarray(nrmse.sum(axis=1))

        worth = {}
        for subset in _subsets(names):
            terms = frozenset(t for t in chosen if t.finding in subset)
            mean_square = evidence.held_out_mse(terms, corrected=False)
            worth[subset] = -total_nrmse(mean_square)

        closed = worth[tuple(names)] - worth[()]
        above_floor = -worth[()] - total_nrmse(evidence.floor2)

        # Effects may close more than lies above an estimated floor: then they share what they close.
        whole = np.maximum(above_floor, closed)
        whole = np.maximum(whole, 1e-12)

        shares = {}
        for name in names:
            value = shapley_value(name, names, worth)
            shares[name] = Share.of(value / whole)
        return shares


@dataclass(frozen=True)
class Share:
    """An effect's share of the gap above the floor, and the interval that holds nine of ten draws of the folds."""

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, draws: np.ndarray) -> Share:
        """The share of the first draw, and the interval of the others; all within 0 and 1."""
        inside = np.clip(draws, 0.0, 1.0)
        low, high = np.quantile(inside[1:], [0.05, 0.95])
        return cls(float(inside[0]), float(low), float(high))


def shapley_value(
    name: str, names: list[str], worth: dict[tuple[str, ...], np.ndarray]
) -> np.ndarray:
    """Shapley's value of one of the names, given the worth of every subset in sorted order.

    phi_i = sum over S without i of |S|! (n - |S| - 1)! / n! (v(S + i) - v(S))
    """
    others = [n for n in names if n != name]
    orders = factorial(len(names))
    total = np.zeros_like(worth[()])
    for subset in _subsets(others):
        # Orders of adding that have the subset before the name, and the rest after it.
        before = factorial(len(subset))
        after = factorial(len(others) - len(subset))
        joined = tuple(sorted((*subset, name)))
        added = worth[joined] - worth[subset]
        total += before * after / orders * added
    return total


def join_halves(first: TorqueGap, second: TorqueGap) -> TorqueGap:
    """The first half of one gap and the second half of another on the same samples."""
    middle = len(first.measured) // 2
    measured = np.vstack([first.measured[:middle], second.measured[middle:]])
    predicted = np.vstack([first.predicted[:middle], second.predicted[middle:]])
    return TorqueGap(measured, predicted, first.edges)


def _concatenated(gaps: list[TorqueGap]) -> TorqueGap:
    """Gaps of several folds as one."""
    edges = [0]
    for gap in gaps:
        start = edges[-1]
        edges += [start + edge for edge in gap.edges[1:]]
    return TorqueGap(
        measured=np.vstack([gap.measured for gap in gaps]),
        predicted=np.vstack([gap.predicted for gap in gaps]),
        edges=tuple(edges),
    )


def _subsets(names: list[str]) -> list[tuple[str, ...]]:
    """All subsets of names, in their order, the empty one first."""
    sizes = range(len(names) + 1)
    return [subset for size in sizes for subset in combinations(names, size)]


def _fold_weights(rows: np.ndarray, draws: int) -> np.ndarray:
    """Rows of each fold, (F, n), as often as each draw holds it; the first draw holds each once: (draws + 1, F, n)."""
    folds = len(rows)
    chance = np.full(folds, 1 / folds)
    # A fixed seed: the same case has the same intervals.
    counts = np.random.default_rng(0).multinomial(folds, chance, size=draws)

    once = np.ones(folds)
    held = np.vstack([once, counts])
    return np.asarray(held[:, :, None] * rows)


# The gap that a selection leaves on held-out data, beside the floor of a healthy arm.


@dataclass(frozen=True)
class MeasuredGap:
    """What a selection leaves, n joints.

    Attributes:
        gap_after: on held-out data.
        inertial_mse: mean square that likely errors of the nominal inertials explain [N^2 m^2], (n,).
        floor: RMS that a healthy arm of this kind would leave [N m], (n,).
        residual: what exceeds the floor.
    """

    gap_after: TorqueGap
    inertial_mse: np.ndarray
    floor: np.ndarray
    residual: ExcessResidual


def measured_gap(predictor: HeldOutPredictor) -> MeasuredGap:
    """Gap, floor and excess residual with the selection of a predictor."""
    selection, terms = predictor.selection, predictor.selection.fit.terms
    gap_before, gap_after = predictor.gap(frozenset()), predictor.gap(terms)
    corrected = selection.corrected(selection.fit.theta, terms)
    fitted_gap = torque_gap(corrected, predictor.body, predictor.segments)
    inertial_mse = _inertial_error_mse(selection, fitted_gap)
    floor = np.sqrt(_noise_mse(predictor, corrected, fitted_gap) + inertial_mse)
    residual = excess_residual(selection, gap_after.rmse)
    if predictor.set_aside:
        on_set_aside = excess_residual_set_aside(
            selection, gap_before, gap_after, floor
        )
        residual = elementwise_max(residual, on_set_aside)
    return MeasuredGap(gap_after, inertial_mse, floor, residual)


def _noise_mse(
    predictor: HeldOutPredictor, corrected: CorrectedArm, gap: TorqueGap
) -> np.ndarray:
    """Mean square that noise, timing and form leave on a healthy arm, over all segments [N^2 m^2], (n,)."""
    segments, lengths = predictor.segments, np.diff(gap.edges)
    floors = [noise_floor(corrected, predictor.body, s).floor for s in segments]
    return np.average(np.square(floors), axis=0, weights=lengths)


def _inertial_error_mse(selection: Selection, gap: TorqueGap) -> np.ndarray:
    """Mean square that likely errors of the nominal inertials explain [N^2 m^2], (n,).

    The gap is measured twice: by the evidence, on the decimated rows of the search, and by ``torque_gap`` at the full
    rate. Inertial errors are known to the former only, hence the rescaling to the deviation of the latter's torque;
    the other place is ``excess_residual``, which takes the smaller of both.
    """
    evidence, terms = selection.evidence, selection.fit.terms

    with_errors = evidence.held_out_mse(terms, corrected=False)
    without_errors = evidence.mse_plausible_inertials(terms)
    rows = evidence.rows
    explained = (with_errors * rows).sum(axis=0) - (without_errors * rows).sum(axis=0)
    explained = np.clip(explained, 0.0, None) / rows.sum(axis=0)

    full_rate_over_search = torque_scale(gap.measured) / selection.scale
    return np.asarray(explained * full_rate_over_search**2)


# Rejection: terms that the search found and that widen the gap on held-out data.


@dataclass(frozen=True)
class Rejection:
    """Terms of one effect that are rejected.

    Attributes:
        terms: the terms.
        reason: why, in words.
        cost: torque NRMSE that they add on the joint where they do most harm.
    """

    terms: frozenset[Term]
    reason: str
    cost: float


def reject(predictor: HeldOutPredictor) -> tuple[Selection, list[Rejection]]:
    """Reject terms that widen a joint's held-out gap beyond the nominal arm's."""
    selection, rejections = predictor.selection, []
    while selection.fit.terms:
        rejection = _harmful(predictor.of(selection))
        if rejection is None:
            break
        rejections.append(rejection)
        kept = selection.fit.terms - rejection.terms
        selection = replace(selection, fit=selection.evidence.fit_possible(kept))
    return selection, rejections


def _harmful(predictor: HeldOutPredictor) -> Rejection | None:
    """The term that does most harm on the joint whose gap all terms together widen most."""
    terms = predictor.selection.fit.terms
    with_all = predictor.gap(terms).nrmse
    without_any = predictor.gap(frozenset()).nrmse
    harm = with_all - without_any

    # The worst joint first: once its term is rejected, others may be right.
    joint = int(np.argmax(harm)) + 1
    if harm[joint - 1] <= VISIBLE_EFFECT:
        return None

    costs = {}
    for term in sorted(terms, key=lambda t: (t.effect, t.joint)):
        # Terms that act on another joint alone cannot have widened this joint's gap.
        if term.joint == joint or term.definition.reach != "joint":
            without = predictor.gap(terms - {term}).nrmse
            costs[term] = with_all[joint - 1] - without[joint - 1]

    worst = max(costs, key=lambda term: costs[term], default=None)
    if worst is None or costs[worst] <= 0:
        return None
    reason = f"widens the gap of joint {joint} on unseen data"
    return Rejection(frozenset({worst}), reason, float(costs[worst]))


# Significance by split samples, with the false discovery rate controlled.
#
# Pieces of the recordings are assigned alternately to two halves, A and B. For an effect among those found,
#
#     log e = l_B|A(all effects, fitted to A) - max l_B|A(all but this one)
#
# with l_B|A the Gaussian log likelihood of the weighted gap of B, by effective samples, given what A says of the
# nominal arm's errors: half of L(A) - L(A and B), L the least sum of squares over them. Whatever values A gives to
# the effect, E[e] <= 1 if the effect is absent, so that 1 / e bounds the probability of such a value [wasserman2020];
# the same holds for the mean of e over both directions. Of m effects tried, those are confirmed of which the k-th
# largest e is at least m / (k rate): then at most that share of them is expected to be there by chance, whatever
# their dependence [wang2022].
#
# An effect that errors of the nominal arm could imitate is hard to confirm: once A has estimated these errors, they
# predict B no worse. The evidence still prefers it, because one change of one body costs less than errors of all
# bodies. On short or odd recordings the values that A gives to all other effects fail on B, and nothing is confirmed.
# An effect that is not confirmed stays in the diagnosis, marked as such.


def log_e_values(selection: Selection) -> dict[str, float]:
    """log e of each effect found [nats]; compliant joints have none, as no linear model is without them."""
    evidence, terms = selection.evidence, selection.fit.terms
    first, second = alternate_pieces(evidence)

    def least(total: np.ndarray) -> np.ndarray:
        return NormalEquations(total, evidence.terms.size, evidence.prior).least

    least_first, least_second = least(first), least(second)
    least_both = least(first + second)

    # Pairs of the half that is fitted, and what the other half adds to it.
    directions = [
        (least_first, least_both - least_first),
        (least_second, least_both - least_second),
    ]

    rigid = frozenset(t for t in terms if t.definition.locally_linear)
    out = {}
    for tested_terms in by_finding(rigid):
        logs = [
            log_e_value(terms, tested_terms, fitted, tested)
            for fitted, tested in directions
        ]
        name = next(iter(tested_terms)).finding
        out[name] = _log_mean(logs)
    return out


def false_discovery_rates(
    log_e: Mapping[str, float], tried: int | None = None
) -> dict[str, float]:
    """The least false discovery rate at which each effect would be confirmed, at most 1 (e-BH).

    With e-values in falling order, e_(1) >= e_(2) ..., the first k are confirmed at the rate m / (k e_(k)), and with
    them every larger one. Source: wang2022.

    Args:
        log_e: of each effect found [nats].
        tried: m, number of effects that were tried; ``None`` for all that a torque gap can show.
    """
    tried = len(explained()) if tried is None else tried
    ranked = sorted(log_e, key=lambda name: log_e[name], reverse=True)

    rates = []
    for k, name in enumerate(ranked, 1):
        # The bound keeps the inverse finite; the rate is 1 there anyway.
        inverse = float(np.exp(-max(log_e[name], -50.0)))
        rates.append(min(1.0, tried / k * inverse))

    # A larger e is confirmed whenever a smaller one is.
    return {name: min(rates[k:]) for k, name in enumerate(ranked)}


def log_e_value(
    terms: frozenset[Term],
    part: frozenset[Term],
    fitted: np.ndarray,
    tested: np.ndarray,
) -> float:
    """log e of some of the terms [nats].

    Args:
        terms: all terms.
        part: those that are tested.
        fitted: L of the half that is fitted, (P + 1, P + 1); half of [theta; -1]^T L [theta; -1] is the loss.
        tested: L of both halves less that of the fitted one, (P + 1, P + 1).
    """

    def loss(theta: np.ndarray) -> float:
        z = np.append(theta, -1.0)
        return 0.5 * float(z @ tested @ z)

    # Without the part, all others may fit the tested half itself: the most favourable case against the part.
    without_part = solve(tested, _columns(terms - part))
    with_all = solve(fitted, _columns(terms))
    return loss(without_part) - loss(with_all)


def _columns(terms: frozenset[Term]) -> np.ndarray:
    return np.array(sorted(c for t in terms for c in t.columns), dtype=int)


def _log_mean(logs: list[float]) -> float:
    """Logarithm of the mean of values with these logarithms."""
    return float(np.logaddexp.reduce(logs) - np.log(len(logs)))
