"""A model fitted to folds: its presliding, its refinement, and what of it can be seen."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.model.fit_data import FitData
from gapscope.diagnosis.model.linearisation import Linearisation
from gapscope.diagnosis.selection.evidence import Evidence, Fit, evidences
from gapscope.diagnosis.thresholds import (
    LINEAR_ENOUGH,
    MAX_EVIDENCE_LOSS,
    MOVE_GAIN,
    PRESLIDING_GAIN,
    REFINE_GAIN,
    REFINE_STEPS,
    REFUSED_MOVES,
    RELINEARISATIONS,
    VISIBLE_EFFECT,
    VISIBLE_TERM,
)
from gapscope.effects.catalogue import explained
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import DryLaw
from gapscope.effects.friction import PRESLIDING_DISTANCES
from gapscope.model.conditioning import Segment
from gapscope.model.terms import Term, Terms

# The model of the search: a set of terms fitted around its own values. Moves return a new one.


@dataclass(frozen=True)
class Model:
    """A set of terms, fitted around its own values.

    Attributes:
        linear: the linearisation around the values.
        evidences: the evidence on it at each level of the nuisances' prior, best first.
        fit: the terms and their values.
    """

    linear: Linearisation
    evidences: tuple[Evidence, ...]
    fit: Fit

    @property
    def data(self) -> FitData:
        """The data that it is fitted to."""
        return self.linear.data

    @property
    def terms(self) -> Terms:
        """All terms that could be chosen, with their shapes."""
        return self.linear.terms

    @property
    def evidence(self) -> Evidence:
        """The evidence under the error of the nominal inertials that explains the data best."""
        return self.evidences[0]

    def best(self, terms: frozenset[Term]) -> Fit:
        """Fit of a set of terms under the error of the nominal inertials that suits it best.

        An effect that wide errors replaced until now needs narrow ones beside it.
        """
        (fit,) = self.best_of([terms])
        return fit

    def best_of(self, sets: Sequence[frozenset[Term]]) -> list[Fit]:
        """The same for each of many sets of terms."""
        by_level = [evidence.fits(sets) for evidence in self.evidences]
        each = zip(*by_level, strict=True)
        return [max(fits, key=lambda fit: fit.score) for fits in each]

    def gain_of(self, other: Model) -> float:
        """Evidence of another model less that of this one [nats], each around its own values.

        Samples, which differ between linearisations, count with their mean; of what is expected to be left the less:
        a healthy arm is no worse than the better model shows.
        """
        mine, its = self.evidence.scored, other.evidence.scored
        samples = 0.5 * (mine.independent + its.independent)
        expected2 = np.minimum(mine.expected2, its.expected2)
        my_misfit, its_misfit = (
            float((samples * np.log1p(model.fit.scored_mse / expected2)).sum())
            for model in (self, other)
        )
        closed = (my_misfit - its_misfit) / 2
        return closed - other.fit.cost + self.fit.cost


def nominal_model(
    arm: NominalArm,
    body: RigidBody,
    folds: list[list[Segment]],
    cutoff: float,
) -> Model:
    """The model without any term.

    Args:
        arm, body: the nominal arm and its dynamics.
        folds: segments per fold.
        cutoff: cut-off of the fit's filter [Hz].
    """
    data = FitData(arm, body, folds, cutoff)
    terms = Terms(arm.n_joints, motors=arm.coupled_motors)
    linear = Linearisation(data, np.zeros(terms.size), terms)
    mean_squares = [
        fold.total[:, -2, -2] / np.maximum(fold.count, 1e-9)
        for fold in (half.scored for half in linear.folds)
    ]
    ranked = evidences(linear, np.array(mean_squares), frozenset())
    return Model(linear, ranked, ranked[0].fit(frozenset()))


def fit_terms(
    model: Model,
    terms: frozenset[Term],
    starts: Mapping[Term, np.ndarray] | None = None,
    least_gain: float = -np.inf,
) -> Model:
    """A model with a set of terms, less those whose values turn out impossible.

    Linearises around the values until the torque there is what the linearisation says, and weighs the data anew.

    Args:
        model: the model to begin from.
        terms: the set.
        starts: linear coordinates of some of them to linearise around at first, instead of those fitted.
        least_gain: evidence over the model to begin from [nats] below which it is not linearised once more.
    """
    beginning = model
    for _ in range(RELINEARISATIONS):
        fit = _fit_from(model, terms, starts or {})
        if not starts and _nearly_linear(model.linear, fit):
            return _weighed_anew(model.linear, fit)
        model = _linearised_around(model, fit)
        terms, starts = model.fit.terms, None
        if beginning.gain_of(model) < least_gain:
            break
    return model


def relinearise(model: Model) -> Model:
    """The same terms, linearised around their values, so that what could be added is looked for in what is left.

    A model whose torque is at its values what its own linearisation says of the same terms stays as it is.
    """
    linear, fit = model.linear, model.fit
    if _in_use(linear) == fit.terms and _nearly_linear(linear, fit):
        return model
    return _linearised_around(model, fit)


def _in_use(linear: Linearisation) -> frozenset[Term]:
    """The terms around whose values a linearisation is."""
    theta = linear.theta
    return frozenset(t for t in linear.terms.all if theta[list(t.columns)].any())


def _nearly_linear(linear: Linearisation, fit: Fit) -> bool:
    """Whether the torque at the values of a fit is what its linearisation says, so that no new one is needed."""
    for term in fit.terms:
        effect, shaped = term.definition, bool(term.parametrisation.nonlinear)
        # a shape is refined only once its term is in use
        begins = not linear.theta[list(term.columns)].any()
        if effect.limits or (begins and not effect.locally_linear):
            return False
        if shaped and term not in linear.refined:
            return False
    return bool(linear.departure(fit.theta).max() < LINEAR_ENOUGH)


def _linearised_around(model: Model, fit: Fit) -> Model:
    """The terms of a fit, fitted on a linearisation around its values."""
    refined = {t: shape.values for t, shape in model.linear.refined.items()}
    shapes = {**model.terms.shapes, **refined}
    terms = replace(model.terms, shapes=shapes)
    linear = Linearisation(model.data, _expansion_point(fit), terms)
    return _weighed_anew(linear, fit)


def _weighed_anew(linear: Linearisation, fit: Fit) -> Model:
    """The terms of a fit, fitted on a linearisation with rows weighed by what the fit leaves."""
    ranked = evidences(linear, fit.scored_mse, fit.terms)
    return Model(linear, ranked, ranked[0].fit_possible(fit.terms))


def _fit_from(
    model: Model, terms: frozenset[Term], starts: Mapping[Term, np.ndarray]
) -> Fit:
    """Fit of a set of terms without those that start at given values, then set to these."""
    fit = model.evidence.fit_possible(terms - frozenset(starts))
    if not starts:
        return fit
    theta = fit.theta.copy()
    for term, values in starts.items():
        theta[list(term.columns)] = values
    return replace(fit, terms=fit.terms | frozenset(starts), theta=theta)


def _expansion_point(fit: Fit) -> np.ndarray:
    """Values around which to linearise: saturation is there or not, how much of it is in its shape."""
    theta = fit.theta.copy()
    limiting = [t.columns[0] for t in fit.terms if t.definition.limits]
    theta[limiting] = 1.0
    return theta


# Presliding beside the dry friction that was found: over what distance it builds up after a reversal.
#
# It is no cause of a gap but part of how dry friction acts: sgn v says nothing of a joint that rests or turns round
# slowly, where most of what dry friction leaves lies. The search trusts these samples least and does without; the
# distance of each joint then comes from a grid, with the values as fitted. It has to narrow the gap of all samples, and
# the trusted ones decide: a distance that suits rests alone does harm on motions without any.


def presliding_distances(model: Model) -> np.ndarray:
    """Distance of each joint [rad], (n,); 0 without dry friction found, or where the gap does not fall decisively."""
    at_once = np.zeros(model.data.arm.n_joints)
    dry = has_dry_friction(model.fit.terms, len(at_once))
    if not dry.any():
        return at_once
    size = model.data.arm.per_radian
    grid = np.array(
        [np.where(dry, d * size, 0.0) for d in (0.0, *PRESLIDING_DISTANCES)]
    )
    squares = np.array([_squared_gap(model, distance) for distance in grid])
    everywhere, trusted = squares[:, 0], squares[:, 1]
    trusted = np.where(everywhere <= everywhere[0], trusted, np.inf)
    best = np.argmin(trusted, axis=0)
    samples = model.evidence.torque.independent.sum(axis=0)
    gain = 0.5 * samples * np.log(trusted[0] / trusted.min(axis=0))
    chosen = grid[best, np.arange(len(best))]
    return np.where(gain > PRESLIDING_GAIN, chosen, 0.0)


def has_dry_friction(terms: Iterable[Term], n_joints: int) -> np.ndarray:
    """Which joints have a term of dry friction of their own, shape (n,)."""
    dry = np.zeros(n_joints, dtype=bool)
    for term in terms:
        if isinstance(term.definition, DryLaw) and term.definition.reach == "joint":
            dry[term.joint - 1] = True
    return dry


def _squared_gap(model: Model, distance: np.ndarray) -> np.ndarray:
    """Squared gap if dry friction builds up over a distance, over all rows and by trust [N^2 m^2], (2, n)."""
    bent = replace(model.data.arm, presliding=distance)
    effects = model.terms.effects(model.fit.theta, model.fit.terms)
    return model.linear.squared_gap(CorrectedArm(bent, effects))


# What a person could see: how far terms narrow the torque gap, in torque NRMSE.


def visible(model: Model, terms: frozenset[Term]) -> bool:
    """Whether terms instead of the model's close enough of the gap for a person to see it."""
    named = {t.effect for t in model.fit.terms}
    new_effect = any(t.effect not in named for t in terms)
    least = VISIBLE_EFFECT if new_effect else VISIBLE_TERM
    return closed_by(model, model.fit.terms, terms) >= least


def closed_by(model: Model, few: frozenset[Term], many: frozenset[Term]) -> float:
    """How much of the torque NRMSE of some joint more terms close: held out or in sample, whichever is less.

    A slow recording alone may fix a delay so badly that any further term seems to help on the fast one left out;
    fitted to all recordings such a term does nothing. If errors of the nominal inertials hide an effect under a
    wider gap of their own, what it closes once they are removed counts too.
    """
    evidence = model.evidence

    def closed(mean_square: Callable[..., np.ndarray], corrected: bool) -> float:
        few_nrmse, many_nrmse = (
            nrmse(model, mean_square(terms, corrected=corrected))
            for terms in (few, many)
        )
        return float((few_nrmse - many_nrmse).max())

    plain, corrected = (
        min(closed(evidence.held_out_mse, c), closed(evidence.in_sample_mse, c))
        for c in (False, True)
    )
    return max(plain, corrected) if plain > 0 else plain


def closed_between(before: Model, after: Model) -> float:
    """How much of the torque NRMSE of some joint one model closes that another leaves, each by its own values.

    With the errors of the nominal inertials taken out or not, whichever is more.
    """

    def held_out(model: Model, corrected: bool) -> np.ndarray:
        gap = model.evidence.held_out_mse(model.fit.terms, corrected=corrected)
        return nrmse(model, gap)

    return max(
        float((held_out(before, corrected) - held_out(after, corrected)).max())
        for corrected in (False, True)
    )


def nrmse(model: Model, mse: np.ndarray) -> np.ndarray:
    """Torque NRMSE per joint [1], (n,), from the mean square of the gap per fold and joint [N^2 m^2], (F, n)."""
    rows = model.evidence.rows
    mean_square = (mse * rows).sum(axis=0) / rows.sum(axis=0)
    return np.sqrt(mean_square) / model.data.torque_deviation


# Moves of the search: sets of terms one step away from another.


def neighbours(chosen: frozenset[Term], terms: Terms) -> list[frozenset[Term]]:
    """Sets one move away: a term or an effect removed, a term swapped on its joint, an effect renamed.

    Compliant joints stay: a local linearisation cannot test their removal.
    """
    movable = [t for t in terms.all if t in chosen and t.definition.locally_linear]
    moves = chain(
        _without_one_term(chosen, movable),
        _without_one_effect(chosen, movable),
        _with_an_effect_renamed(chosen, movable, terms),
        _with_a_term_swapped(chosen, movable, terms),
    )
    return list(dict.fromkeys(moves))


def _without_one_term(
    chosen: frozenset[Term], movable: list[Term]
) -> Iterator[frozenset[Term]]:
    for term in movable:
        yield chosen - {term}


def _without_one_effect(
    chosen: frozenset[Term], movable: list[Term]
) -> Iterator[frozenset[Term]]:
    for effect in _effects(movable):
        yield frozenset(t for t in chosen if t.effect != effect)


def _with_an_effect_renamed(
    chosen: frozenset[Term], movable: list[Term], terms: Terms
) -> Iterator[frozenset[Term]]:
    """Another effect on the joints of one that is chosen; not its near-equivalent, which is compared at the end."""
    available = [t for t in terms.selectable if t.definition.scope == "joint"]
    named = {t.effect for t in chosen}
    for effect in _effects(movable):
        rest = frozenset(t for t in chosen if t.effect != effect)
        joints = {t.joint for t in chosen - rest}
        for other in _effects(available):
            if other in named or other == near_equivalent(effect):
                continue
            yield rest | {
                t for t in available if t.effect == other and t.joint in joints
            }


def _with_a_term_swapped(
    chosen: frozenset[Term], movable: list[Term], terms: Terms
) -> Iterator[frozenset[Term]]:
    """Another term on the same joint or on the arm; instead of a term on the arm also a changed link."""
    for term in movable:
        for other in terms.selectable:
            if other in chosen or other.effect == near_equivalent(term.effect):
                continue
            if other.joint in (term.joint, 0):
                yield (chosen - {term}) | {other}
        if term.joint == 0:
            for link in terms.all:
                if link.definition.scope == "link":
                    yield (chosen - {term}) | {link}


def _effects(terms: list[Term]) -> list[str]:
    """Names of the effects of some terms, in their order."""
    return list(dict.fromkeys(t.effect for t in terms))


def near_equivalent_pairs() -> list[tuple[str, str]]:
    """Pairs of effects that are equal to first order, the more common one first."""
    return [(e.near_equivalent, e.name) for e in explained() if e.near_equivalent]


def near_equivalent(effect: str) -> str | None:
    """The effect that looks like another one to first order."""
    for common, rare in near_equivalent_pairs():
        if effect == common:
            return rare
        if effect == rare:
            return common
    return None


def clashes(term: Term, chosen: frozenset[Term]) -> bool:
    """Whether a term is chosen already, or its near-equivalent on the same joint."""
    if term in chosen:
        return True
    other = near_equivalent(term.effect)
    return any(t.effect == other and t.joint == term.joint for t in chosen)


def consistent(terms: frozenset[Term]) -> bool:
    """Whether no two of the terms are near-equivalents on one joint."""
    return not any(clashes(term, terms - {term}) for term in terms)


def by_finding(terms: frozenset[Term]) -> list[frozenset[Term]]:
    """The terms of each finding."""
    names = sorted({t.finding for t in terms})
    return [frozenset(t for t in terms if t.finding == name) for name in names]


def by_term(terms: frozenset[Term]) -> list[frozenset[Term]]:
    """Each term on its own."""
    return [frozenset({t}) for t in sorted(terms, key=lambda t: (t.effect, t.joint))]


# Removing and swapping terms of a model: while that raises the evidence, and if nobody could see the difference.


def refine(model: Model) -> Model:
    """Remove and swap terms while that raises the evidence, around their own values as well."""
    visited, refused = {model.fit.terms}, 0
    for _ in range(REFINE_STEPS):
        untried = [
            terms
            for terms in neighbours(model.fit.terms, model.terms)
            if terms not in visited
        ]
        fits = model.evidence.fits(untried)
        best = max(fits, key=lambda fit: fit.score, default=model.fit)
        if best.score < model.fit.score + REFINE_GAIN:
            break
        moved = fit_terms(model, best.terms, least_gain=-MAX_EVIDENCE_LOSS)
        visited |= {best.terms, moved.fit.terms}
        # the linearisation that promised the gain is that of the model before
        if model.gain_of(moved) >= 0:
            model = moved
            continue
        refused += 1
        if refused == REFUSED_MOVES:
            break
    return model


def prune(model: Model) -> Model:
    """Take out, one by one, what no person could see: effects, then terms, whose loss hardly widens the gap.

    Compliant joints stay: a local linearisation cannot test their removal.
    """
    for least, parts in ((VISIBLE_EFFECT, by_finding), (VISIBLE_TERM, by_term)):
        while removable := _removable(model):
            loss = {
                part: closed_by(model, model.fit.terms - part, model.fit.terms)
                for part in parts(removable)
            }
            faintest = min(loss, key=lambda part: loss[part])
            if loss[faintest] >= least:
                break
            model = fit_terms(model, model.fit.terms - faintest)
    return model


def drop_unneeded(model: Model) -> Model:
    """Take out effects without which the evidence falls by less than a move has to raise it, one by one.

    Beside what was pruned an effect may have raised the evidence that it does not raise alone, and wider errors of the
    nominal inertials may do as well without it.
    """
    while parts := by_finding(_removable(model)):
        fits = model.best_of([model.fit.terms - part for part in parts])
        best = max(fits, key=lambda fit: fit.score)
        if best.score <= model.fit.score - MOVE_GAIN:
            return model
        without = fit_terms(model, best.terms)
        if model.gain_of(without) <= -MOVE_GAIN:
            return model
        model = without
    return model


def _removable(model: Model) -> frozenset[Term]:
    return frozenset(t for t in model.fit.terms if t.definition.locally_linear)
