"""Rejection: terms that the search found and that widen the gap on held-out data."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gapscope.diagnosis.assessment.held_out_prediction import HeldOutPredictor
from gapscope.diagnosis.selection.search import Selection
from gapscope.diagnosis.thresholds import VISIBLE_EFFECT
from gapscope.model.terms import Term


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
