"""Compliant joints: found by what is simulated of them, each as elasticity or as backlash, and dropped if not needed.

Elasticity twists in proportion to the torque, free play jumps where the torque changes its sign. A linearisation around
no compliance shows neither, so that each is fitted from its own simulated start, and the two are compared as fitted.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from gapscope.diagnosis.model.terms import Term
from gapscope.diagnosis.selection.fitted_model import Model, fit_terms
from gapscope.diagnosis.selection.refinement import refine
from gapscope.diagnosis.selection.resonance_starts import Start, starts
from gapscope.diagnosis.selection.visibility import closed_between
from gapscope.diagnosis.thresholds import (
    COMPLIANCE_START_SHARE,
    COMPLIANCE_STARTS_TRIED,
    MOVE_GAIN,
    VISIBLE_EFFECT,
)


class Compliance(NamedTuple):
    """Outcome of the comparisons of compliant joints.

    Attributes:
        model: the model that is kept.
        contested: by effect kept and its rival, the evidence of the rival less that of the effect kept [nats].
    """

    model: Model
    contested: Mapping[tuple[str, str], float]


def compliant(terms: frozenset[Term]) -> list[Term]:
    """Terms of compliant joints, in order."""
    found = [t for t in terms if not t.definition.locally_linear]
    return sorted(found, key=lambda t: (t.effect, t.joint))


def best_compliant_joint(model: Model) -> Model | None:
    """The model with elasticity or backlash of the joint that explains most of the residual; ``None`` if none does."""
    fitted = [_started(model, start) for start in _promising(starts(model))]
    better = [
        larger
        for larger in fitted
        if len(compliant(larger.fit.terms)) > len(compliant(model.fit.terms))
        and model.gain_of(larger) > MOVE_GAIN
        and closed_between(model, larger) >= VISIBLE_EFFECT
    ]
    return max(better, key=model.gain_of, default=None)


def _promising(found: list[Start]) -> list[Start]:
    """The starts that are fitted: a few that promise not much less than the best one."""
    least = COMPLIANCE_START_SHARE * max((start.gain for start in found), default=0.0)
    return [start for start in found if start.gain >= least][:COMPLIANCE_STARTS_TRIED]


def _started(model: Model, start: Start) -> Model:
    """The model with one more compliant joint, fitted from a start."""
    return fit_terms(model, model.fit.terms | {start.term}, {start.term: start.values})


def settle_compliance(model: Model) -> Compliance:
    """Try the model without each compliant joint, and with its rival, elasticity or backlash, in its place.

    Each is fitted around its own values. Joints whose compliance no person could see become rigid.
    """
    contested: dict[tuple[str, str], float] = {}
    for term in compliant(model.fit.terms):
        if term not in model.fit.terms:
            continue
        without = fit_terms(model, model.fit.terms - {term})
        kept, rival = (term.effect, model), _rival(without, term)
        lead = 0.0
        if rival is not None:
            lead = model.gain_of(rival[1])
            kept, rival = (rival, kept) if lead > 0 else (kept, rival)
        loss = kept[1].gain_of(without)
        if loss > 0 or closed_between(without, kept[1]) < VISIBLE_EFFECT:
            model = without
            continue
        # of several joints the one that is needed most counts
        _keep_least(contested, (kept[0], "none"), loss)
        if rival is not None:
            _keep_least(contested, (kept[0], rival[0]), -abs(lead))
        model = refine(kept[1]) if lead > 0 else model
    return Compliance(model, contested)


def _rival(without: Model, term: Term) -> tuple[str, Model] | None:
    """The other compliance than that of a term, and a rigid joint's model with it; ``None`` if it explains far less."""
    for start in _promising(starts(without, [term.joint])):
        if start.term.effect == term.effect:
            continue
        model = _started(without, start)
        if start.term in model.fit.terms:
            return start.term.effect, model
    return None


def _keep_least(
    contested: dict[tuple[str, str], float], key: tuple[str, str], gain: float
) -> None:
    contested[key] = min(gain, contested.get(key, 0.0))
