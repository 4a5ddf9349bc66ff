"""Refusals: what the search found and unseen data does not bear out is taken back."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gapscope.diagnosis.assessment.alternatives import rivals
from gapscope.diagnosis.assessment.held_out_prediction import HeldOutPredictor
from gapscope.diagnosis.model.terms import Term
from gapscope.diagnosis.selection.search import Selection
from gapscope.diagnosis.thresholds import NAMED_PROBABILITY


@dataclass(frozen=True)
class Rejection:
    """Terms of one effect that are taken back.

    Attributes:
        terms: the terms.
        reason: why, in words.
        cost: torque NRMSE that they add, or fail to take away, on the joint where they do most harm.
    """

    terms: frozenset[Term]
    reason: str
    cost: float


def reject(predictor: HeldOutPredictor) -> tuple[Selection, list[Rejection]]:
    """Take back terms that widen the gap of a joint on unseen data beyond the nominal arm's, and improbable effects."""
    selection, rejections = predictor.selection, []
    while selection.fit.terms:
        refusal = _harmful(_with(predictor, selection)) or _improbable(selection)
        if refusal is None:
            break
        rejections.append(refusal)
        selection = replace(
            selection, fit=selection.evidence.fit(selection.fit.terms - refusal.terms)
        )
    return selection, rejections


def _with(predictor: HeldOutPredictor, selection: Selection) -> HeldOutPredictor:
    """The same judge over another result of the search."""
    return HeldOutPredictor(
        predictor.arm, predictor.body, selection, predictor.folds, predictor.judged
    )


def _harmful(predictor: HeldOutPredictor) -> Rejection | None:
    """The term that does most harm on a joint whose gap is wider with all terms than without any."""
    terms = predictor.selection.fit.terms
    with_all = predictor.gap(terms).nrmse
    harm = with_all - predictor.gap(frozenset()).nrmse
    joint = int(np.argmax(harm))
    if harm[joint] <= 0.01:
        return None
    costs = {
        term: with_all[joint] - predictor.gap(terms - {term}).nrmse[joint]
        for term in sorted(terms, key=lambda t: (t.effect, t.joint))
        if term.joint == joint + 1 or term.definition.reach == "arm"
    }
    worst = max(costs, key=lambda term: costs[term], default=None)
    if worst is None or costs[worst] <= 0:
        return None
    reason = f"widens the gap of joint {joint + 1} on unseen data"
    return Rejection(frozenset({worst}), reason, float(costs[worst]))


def _improbable(selection: Selection) -> Rejection | None:
    for name in sorted({t.finding for t in selection.fit.terms}):
        probability, others = rivals(selection, name)
        if probability < NAMED_PROBABILITY:
            terms = frozenset(t for t in selection.fit.terms if t.finding == name)
            return Rejection(
                terms,
                f"is improbable ({probability:.0%}); {others[0].effect} does as well",
                0.0,
            )
    return None
