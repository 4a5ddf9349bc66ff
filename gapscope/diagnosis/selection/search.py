"""The search for the terms that explain the gap: forward by groups and by pairs of them, with swaps and removal."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.selection.compliant_joints import (
    best_compliant_joint,
    compliant,
    settle_compliance,
)
from gapscope.diagnosis.selection.evidence import Evidence, Fit
from gapscope.diagnosis.selection.fitted_model import (
    Model,
    fit_terms,
    nominal_model,
    relinearise,
)
from gapscope.diagnosis.selection.groups import best_groups
from gapscope.diagnosis.selection.load_or_link import prefer_payload
from gapscope.diagnosis.selection.moves import consistent
from gapscope.diagnosis.selection.near_equivalents import compare_near_equivalents
from gapscope.diagnosis.selection.presliding import (
    has_dry_friction,
    presliding_distances,
)
from gapscope.diagnosis.selection.refinement import drop_unneeded, prune, refine
from gapscope.diagnosis.selection.turned_base import add_turned_base
from gapscope.diagnosis.selection.visibility import visible
from gapscope.diagnosis.thresholds import (
    FORWARD_STEPS,
    GROUPS_TRIED,
    HOPELESS_LOSS,
    MOVE_GAIN,
    PAIRED_GROUPS,
    SEARCH_RATE,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import Segment, thinned
from gapscope.model.terms import Term

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
    return Selection(
        nominal.data.torque_deviation,
        model.fit,
        model.evidence,
        considered,
        {**replaced, **unlike},
        nominal.fit.held_out_mse,
        body.last_link + 1,
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
                tried = fit_terms(model, group.terms, least_gain=-HOPELESS_LOSS)
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
    larger = fit_terms(model, best.terms, least_gain=-HOPELESS_LOSS)
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
        larger = fit_terms(model, group.terms, least_gain=-HOPELESS_LOSS)
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
