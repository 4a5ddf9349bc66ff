"""Refusals: what the search found and unseen data does not bear out is taken back."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gapscope.diagnosis.assessment.alternatives import rivals
from gapscope.diagnosis.assessment.held_out_prediction import Judge
from gapscope.diagnosis.model.terms import Term
from gapscope.diagnosis.selection.search import Search

REACHING = ("encoder_offset", "joint_elasticity", "backlash", "link_inertia")
"""Effects on one joint that change the torque of others."""
LEAST_PROBABILITY = 0.5
"""An effect less probable than this is not named."""


@dataclass(frozen=True)
class Refusal:
    """Terms of one effect that are taken back.

    Attributes:
        terms: the terms.
        reason: why, in words.
        cost: torque NRMSE that they add, or fail to take away, on the joint where they do most harm.
    """

    terms: frozenset[Term]
    reason: str
    cost: float


def refuse(judge: Judge) -> tuple[Search, list[Refusal]]:
    """Take back terms that widen the gap of a joint on unseen data beyond the nominal arm's, and improbable effects."""
    found, refusals = judge.found, []
    while found.fit.terms:
        refusal = _harmful(_with(judge, found)) or _improbable(found)
        if refusal is None:
            break
        refusals.append(refusal)
        found = replace(found, fit=found.evidence.fit(found.fit.terms - refusal.terms))
    return found, refusals


def _with(judge: Judge, found: Search) -> Judge:
    """The same judge over another result of the search."""
    return Judge(judge.arm, judge.body, found, judge.folds, judge.judged)


def _harmful(judge: Judge) -> Refusal | None:
    """The term that does most harm on a joint whose gap is wider with all terms than without any."""
    terms = judge.found.fit.terms
    with_all = judge.gap(terms).nrmse
    harm = with_all - judge.gap(frozenset()).nrmse
    joint = int(np.argmax(harm))
    if harm[joint] <= 0.01:
        return None
    costs = {
        term: with_all[joint] - judge.gap(terms - {term}).nrmse[joint]
        for term in sorted(terms, key=lambda t: (t.effect, t.joint))
        if term.joint in (joint + 1, 0) or term.effect in REACHING
    }
    worst = max(costs, key=lambda term: costs[term], default=None)
    if worst is None or costs[worst] <= 0:
        return None
    reason = f"widens the gap of joint {joint + 1} on unseen data"
    return Refusal(frozenset({worst}), reason, float(costs[worst]))


def _improbable(found: Search) -> Refusal | None:
    for name in sorted({t.finding for t in found.fit.terms}):
        probability, others = rivals(found, name)
        if probability < LEAST_PROBABILITY:
            terms = frozenset(t for t in found.fit.terms if t.finding == name)
            return Refusal(
                terms,
                f"is improbable ({probability:.0%}); {others[0].effect} does as well",
                0.0,
            )
    return None
