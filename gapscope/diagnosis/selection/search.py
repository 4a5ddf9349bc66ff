"""The search for a set of effects: its moves, groups of joints, and near equivalents."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.selection.evidence import Evidence, Fit
from gapscope.diagnosis.selection.fitted_model import (
    Model,
    clashes,
    consistent,
    drop_unneeded,
    fit_terms,
    has_dry_friction,
    near_equivalent_pairs,
    nominal_model,
    nrmse,
    presliding_distances,
    prune,
    refine,
    relinearise,
    visible,
)
from gapscope.diagnosis.selection.questions import (
    add_turned_base,
    best_compliant_joint,
    compliant,
    prefer_payload,
    settle_compliance,
)
from gapscope.diagnosis.thresholds import (
    DECISIVE_EVIDENCE,
    DECISIVE_NRMSE,
    FORWARD_STEPS,
    GROUPS_TRIED,
    LONGEST_COMPARED_DELAY,
    MAX_EVIDENCE_LOSS,
    MOVE_GAIN,
    PAIRED_GROUPS,
    SEARCH_RATE,
    UNDECIDED_EVIDENCE,
)
from gapscope.effects.catalogue import effect as by_name
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Effect, Path
from gapscope.model.conditioning import Segment, thinned
from gapscope.model.terms import Term

# Groups: for each effect the joints, or the link, to add it on.


def best_groups(model: Model) -> list[Fit]:
    """For each effect that can be added, the model with it on its best group of joints."""
    chosen = model.fit.terms
    added = [term for term in model.terms.selectable if not clashes(term, chosen)]
    fits = model.evidence.fits([chosen | {term} for term in added])
    groups = []
    for effect in model.terms.definitions:
        pairs = zip(added, fits, strict=True)
        singles = [fit for term, fit in pairs if term.effect == effect.name]
        if singles:
            groups.append(_best_group(model, effect, singles))
    return groups


def _best_group(model: Model, effect: Effect, singles: list[Fit]) -> Fit:
    """The best group of joints for one effect, from the fits of the model with it on one joint, or link, each.

    Joints are added in the order of their own gain, links one at a time.
    """
    evidence = model.evidence
    singles = sorted(singles, key=lambda fit: -fit.score)
    if effect.scope != "joint":
        return model.best(singles[0].terms)
    group = model.fit
    for single in singles:
        extended = evidence.fit(group.terms | single.terms)
        if extended.score > group.score:
            group = extended
    # an effect that helps on no joint may still be half of a pair
    return model.best(singles[0].terms if group is model.fit else group.terms)


# Effects that look alike to first order, compared each around its own values.
#
# Two that make the torque late by T, a delay and a lag, differ in the second order. With n the torque that the joint
# needs, recorded is n + T dn/dt + a T^2 d2n/dt2 + b T^3 d3n/dt3, with a and b of ``Path.late_forms``; each form of the
# rarer effect is compared with the more common one around that one's own values, the time T free on every joint.


class Comparison(NamedTuple):
    """Outcome of comparisons.

    Attributes:
        model: the model that is kept.
        contested: by effect kept and its rival, the evidence of the rival less that of the effect kept [nats].
    """

    model: Model
    contested: Mapping[tuple[str, str], float]


def compare_near_equivalents(model: Model) -> Comparison:
    """Refit each near-equivalent effect and keep the better.

    The second of a pair is named only if it is decisively better; if neither is, both stay open.
    """
    contested: dict[tuple[str, str], float] = {}
    for common, rare in near_equivalent_pairs():
        held = {t.effect for t in model.fit.terms} & {common, rare}
        if len(held) == 1:
            model, outcome = _compare(model, held.pop(), common, rare)
            contested.update(outcome)
    return Comparison(model, contested)


def _compare(model: Model, chosen: str, common: str, rare: str) -> Comparison:
    """The model with one of two effects, each on the joints of the one that is chosen."""
    other = rare if chosen == common else common
    models = {chosen: model, other: _renamed(model, chosen, other)}
    gain = _gain_by_form(models[common], common, rare)
    # what differs in its second order in time needs no threshold
    if gain is not None:
        winner, loser = (rare, common) if gain > 0 else (common, rare)
        return Comparison(models[winner], {(winner, loser): -abs(gain)})
    gain = models[common].gain_of(models[rare])
    gaps = {name: nrmse(one, one.fit.held_out_mse) for name, one in models.items()}
    apart = float(np.abs(gaps[rare] - gaps[common]).max())
    decisive = abs(gain) > DECISIVE_EVIDENCE and apart > DECISIVE_NRMSE
    winner, loser = (rare, common) if decisive and gain > 0 else (common, rare)
    evidence = -abs(gain) if decisive else UNDECIDED_EVIDENCE
    return Comparison(models[winner], {(winner, loser): evidence})


def _renamed(model: Model, effect: str, other: str) -> Model:
    """The model with another effect on the joints of one of its effects."""
    mine = {t for t in model.fit.terms if t.effect == effect}
    joints = {t.joint for t in mine}
    put = {t for t in model.terms.selectable if t.effect == other and t.joint in joints}
    return fit_terms(model, (model.fit.terms - mine) | put)


def _gain_by_form(model: Model, common: str, rare: str) -> float | None:
    """Evidence of the best form of the rare effect less that of the common one, which the model has [nats].

    ``None`` if they are not told apart by their second order in time, or if the time is too long for that.
    """
    own, other = by_name(common), by_name(rare)
    if not (isinstance(own, Path) and isinstance(other, Path) and own.late_forms):
        return None
    mine = [t for t in model.fit.terms if t.effect == common]
    times = np.zeros(model.data.arm.n_joints)
    for term in mine:
        times[term.joint - 1] = model.fit.theta[term.columns[0]]
    if not times.any() or times.max() > LONGEST_COMPARED_DELAY:
        return None
    first, second, third = _rates(model, [t for t in model.fit.terms if t not in mine])
    gains = []
    for form in other.late_forms:
        apart = np.subtract(form, own.late_forms[0])
        change = apart[0] * times**2 * second + apart[1] * times**3 * third
        gains.append(model.linear.scan_residual.gain(change, free=first))
    return max(gains)


def _rates(model: Model, terms: list[Term]) -> list[np.ndarray]:
    """First to third derivative by time of the torque that a model's arm with some terms needs, on the rows, (M, n)."""
    data = model.data
    arm = CorrectedArm(data.arm, model.terms.effects(model.fit.theta, terms))
    rates: list[list[np.ndarray]] = [[], [], []]
    for segment in data.segments:
        series = arm.unlimited.predict(segment.bodies(data.body), segment.motion)
        for rows in rates:
            series = np.gradient(series, segment.motion.t, axis=0)
            rows.append(data.thin(series, segment))
    return [np.vstack(rows) for rows in rates]


# The search for the terms that explain the gap: forward by groups and by pairs of them, with swaps and removal.


Progress = Callable[[str], None]
Considered = tuple[tuple[Fit, Fit], ...]
"""Groups that were added, each with one that was considered in its place."""


@dataclass(frozen=True)
class Selection:
    """Result of a search.

    Attributes:
        scale: normalisation of the torque gap over all folds [N m], (n,).
        fit: the best set of terms, fitted at its own linearisation.
        evidence: the evidence that scored it.
        considered: groups that were added at each step, each with one that was considered in its place.
        contested: by effect found and its rival, the evidence of the rival less that of the effect [nats], each
            around its own values.
        nominal_mse: mean square of the gap per fold and joint without any effect [N^2 m^2], (F, n).
        last_link: the joint that moves the last link, from 1.
        presliding: distance over which the dry friction of a joint builds up, if it has some [rad], (n,).
    """

    scale: np.ndarray
    fit: Fit
    evidence: Evidence
    considered: Considered
    contested: Mapping[tuple[str, str], float]
    nominal_mse: np.ndarray
    last_link: int
    presliding: np.ndarray

    def corrected(self, theta: np.ndarray, terms: frozenset[Term]) -> CorrectedArm:
        """The nominal arm with some terms at values theta, (P,), and the presliding of their dry friction."""
        known, arm = self.evidence.terms, self.evidence.linear.arm
        arm = replace(arm, presliding=self.presliding_of(terms))
        return CorrectedArm(arm, known.effects(known.clipped(theta), terms))

    def presliding_of(self, terms: frozenset[Term]) -> np.ndarray:
        """Distance over which the dry friction of some terms builds up [rad], (n,)."""
        dry = has_dry_friction(terms, len(self.presliding))
        return np.where(dry, self.presliding, 0.0)


def search(
    arm: NominalArm,
    body: RigidBody,
    folds: list[list[Segment]],
    cutoff: float,
    progress: Progress = lambda message: None,
) -> Selection:
    """Find the terms that explain the gap of recordings, by evidence on halves of recordings left out of the fit.

    Args:
        arm, body: the nominal arm and its dynamics.
        folds: segments per fold.
        cutoff: cut-off of the fit's filter [Hz].
        progress: called with a few words at each step.
    """
    nominal = nominal_model(arm, body, searched_folds(folds), cutoff)
    model, considered = add_terms(add_turned_base(nominal), progress)
    model, replaced = compare_near_equivalents(model)
    model, unlike = settle_compliance(model)
    model = relinearise(drop_unneeded(prune(model)))
    return _selected(model, nominal, considered, {**replaced, **unlike})


def without_search(
    arm: NominalArm, body: RigidBody, folds: list[list[Segment]], cutoff: float
) -> Selection:
    """The nominal arm as it is, for recordings of which it explains nothing."""
    nominal = nominal_model(arm, body, searched_folds(folds), cutoff)
    return _selected(nominal, nominal, (), {})


def _selected(
    model: Model,
    nominal: Model,
    considered: Considered,
    contested: Mapping[tuple[str, str], float],
) -> Selection:
    return Selection(
        nominal.data.torque_deviation,
        model.fit,
        model.evidence,
        considered,
        contested,
        nominal.fit.held_out_mse,
        nominal.data.body.last_link + 1,
        presliding_distances(model),
    )


def searched_folds(folds: list[list[Segment]]) -> list[list[Segment]]:
    """Segments of each fold as the search looks at them: decimated to no less than ``SEARCH_RATE``."""
    return [[thinned(s, SEARCH_RATE) for s in fold] for fold in folds]


def add_terms(model: Model, progress: Progress) -> tuple[Model, Considered]:
    """Add terms while some raise the evidence, and what was considered on the way.

    What is too costly to try at each step, compliant joints and pairs of effects, is tried once no group helps.
    """
    model, considered = add_groups(model, progress)
    visited = {model.fit.terms}
    for _ in range(FORWARD_STEPS):
        added = (
            add_compliant_joint(model, progress)
            or add_pair(model, progress)
            or add_better_than_all(model, progress)
        )
        if added is None:
            break
        grown, more = add_groups(added, progress)
        # refining may lead back to a set that was there before
        if grown.fit.terms in visited:
            break
        visited.add(grown.fit.terms)
        model, considered = grown, considered + more
    return model, considered


def add_groups(model: Model, progress: Progress) -> tuple[Model, Considered]:
    """Add the best group of terms while one raises the evidence, each around its own values."""
    considered: Considered = ()
    visited, refused = {model.fit.terms}, set[frozenset[Term]]()
    stiff = False
    for _ in range(FORWARD_STEPS):
        groups, larger = _promising(model, refused), None
        while groups and larger is None:
            group, *groups = groups
            # columns around no compliance only hint at it
            if compliant(group.terms - model.fit.terms):
                tried = None if stiff else best_compliant_joint(model)
                stiff = tried is None
            else:
                tried = fit_terms(model, group.terms, least_gain=-MAX_EVIDENCE_LOSS)
            # the linearisation that promised the gain is that of the smaller model
            if tried is not None and model.gain_of(tried) > 0:
                larger = tried
                considered += tuple((group, other) for other in groups)
                progress("adds " + _described(larger.fit.terms - model.fit.terms))
            else:
                refused.add(group.terms)
        if larger is None:
            break
        model = relinearise(prefer_payload(refine(larger)))
        # refining may lead back to a set that was there before
        if model.fit.terms in visited:
            break
        visited.add(model.fit.terms)
    return model, considered


def _promising(model: Model, refused: set[frozenset[Term]]) -> list[Fit]:
    """The groups to try, best first: those that promise enough evidence and close enough of the gap."""
    groups = [
        fit
        for fit in best_groups(model)
        if fit.score > model.fit.score
        and fit.terms not in refused
        and visible(model, fit.terms)
    ]
    groups.sort(key=lambda fit: fit.score, reverse=True)
    least = model.fit.score + MOVE_GAIN
    return [fit for fit in groups[:GROUPS_TRIED] if fit.score >= least]


def add_compliant_joint(model: Model, progress: Progress) -> Model | None:
    """Add elasticity or backlash of a joint if that explains some of the residual."""
    larger = best_compliant_joint(model)
    if larger is None:
        return None
    progress("adds " + _described(larger.fit.terms - model.fit.terms))
    return relinearise(prefer_payload(refine(larger)))


def add_pair(model: Model, progress: Progress) -> Model | None:
    """Add the best pair of effects that explain the residual only together, if there is one.

    Not beside a compliant joint, whose form leaves more than a pair that shows alone in neither part.
    """
    if compliant(model.fit.terms):
        return None
    best = _best_pair(model)
    if best is None or best.score < model.fit.score + MOVE_GAIN:
        return None
    larger = fit_terms(model, best.terms, least_gain=-MAX_EVIDENCE_LOSS)
    grown = len(larger.fit.terms) > len(model.fit.terms)
    if not grown or model.gain_of(larger) <= MOVE_GAIN:
        return None
    progress("adds " + _described(larger.fit.terms - model.fit.terms))
    return relinearise(prefer_payload(refine(larger)))


def add_better_than_all(model: Model, progress: Progress) -> Model | None:
    """Add a group that predicts a joint's gap better than all terms together, if it helps around its own values.

    What all terms leave is taken for what a healthy arm leaves, and hides what explains no more than that. On little
    data they run away beyond the motions that they were fitted to; one group that does better shows it.
    """
    groups = [
        fit
        for fit in best_groups(model)
        if visible(model, fit.terms)
        and _outdoes_all(model, fit)
        and not compliant(fit.terms - model.fit.terms)
    ]
    groups.sort(key=lambda fit: fit.score, reverse=True)
    for group in groups[:GROUPS_TRIED]:
        larger = fit_terms(model, group.terms, least_gain=-MAX_EVIDENCE_LOSS)
        grown = len(larger.fit.terms) > len(model.fit.terms)
        if grown and model.gain_of(larger) > MOVE_GAIN:
            progress("adds " + _described(larger.fit.terms - model.fit.terms))
            return relinearise(prefer_payload(refine(larger)))
    return None


def _outdoes_all(model: Model, fit: Fit) -> bool:
    """Whether a fit leaves less of a joint's gap than is expected of a healthy arm, and the model more."""
    expected = model.evidence.expected2.mean(axis=0)
    left, before = (one.held_out_mse.mean(axis=0) for one in (fit, model.fit))
    return bool(((left < expected) & (before > expected)).any())


def _best_pair(model: Model) -> Fit | None:
    """The two groups that raise the evidence most together."""
    groups = sorted(best_groups(model), key=lambda fit: -fit.score)[:PAIRED_GROUPS]
    sets = [one.terms | other.terms for one, other in combinations(groups, 2)]
    fits = model.best_of([terms for terms in sets if consistent(terms)])
    seen = [fit for fit in fits if visible(model, fit.terms)]
    return max(seen, key=lambda fit: fit.score, default=None)


def _described(terms: frozenset[Term]) -> str:
    """Effects with their joints, for progress messages."""
    parts = []
    for effect in sorted({t.effect for t in terms}):
        joints = sorted(t.joint for t in terms if t.effect == effect and t.joint)
        parts.append(f"{effect} {joints}")
    return "; ".join(parts)
