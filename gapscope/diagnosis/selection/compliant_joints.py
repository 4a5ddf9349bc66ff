"""Compliant joints: found by what is simulated of them, each as elasticity or as backlash, and dropped if not needed.

Elasticity twists in proportion to the torque, free play jumps where the torque changes its sign. A linearisation around
no compliance shows neither. What each effect offers as starts is simulated on each joint and compared with what the
model leaves; fits begin at the best, and the two are compared as fitted.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gapscope.diagnosis.selection.fitted_model import Model, fit_terms
from gapscope.diagnosis.selection.refinement import refine
from gapscope.diagnosis.selection.visibility import closed_between
from gapscope.diagnosis.thresholds import (
    COMPLIANCE_RATIO,
    COMPLIANCE_START_GAIN,
    COMPLIANCE_START_SHARE,
    COMPLIANCE_STARTS_TRIED,
    MOVE_GAIN,
    VISIBLE_EFFECT,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Transmission
from gapscope.model.terms import Term


@dataclass(frozen=True)
class Start:
    """A term with values to begin with.

    Attributes:
        term: a transmission of one joint, elasticity or backlash.
        values: linear coordinates.
        gain: what these values explain of the residual [nats].
    """

    term: Term
    values: np.ndarray
    gain: float


def starts(model: Model, joints: Iterable[int] | None = None) -> list[Start]:
    """The best start of each effect on each joint that is not compliant yet, the most promising first.

    Args:
        model: the model whose residual is to be explained.
        joints: joints to look at, from 1; all if ``None``.
    """
    if model.data.arm.encoder != "motor":
        return []
    taken = {t.joint for t in model.fit.terms if not t.definition.locally_linear}
    looked_at = _joints_above_floor(model) - taken
    if joints is not None:
        looked_at &= set(joints)
    if not looked_at:
        return []
    arm = CorrectedArm(model.data.arm, model.terms.effects(model.linear.theta))
    bodies, best = model.data.compliance.of(arm), dict[Term, Start]()
    # recorded is what reaches the joint over the scale of its torque
    recorded = 1.0 / (1.0 + arm.quantity("scale"))
    for term in model.terms.all:
        effect, j = term.definition, term.joint - 1
        # bodies on the way of a search may have negative mass
        skipped = term.joint not in looked_at or bodies.mass[j] <= 0
        if skipped or not isinstance(effect, Transmission):
            continue
        needed = np.concatenate([torque[:, j] for torque in bodies.torque])
        for values in effect.starts(bodies.mass[j], needed):
            torque = bodies.added(effect, j, values)
            gain = model.linear.scan_residual.gain(torque * recorded)
            known = best[term].gain if term in best else 0.0
            if gain > max(known, COMPLIANCE_START_GAIN):
                best[term] = Start(term, values, gain)
    return sorted(best.values(), key=lambda start: -start.gain)


def _joints_above_floor(model: Model) -> set[int]:
    """Joints, from 1, whose residual exceeds the floor by enough to look for compliance.

    What bends or rattles shows on its own joint, whatever it does to the others.
    """
    rows, floor2 = model.evidence.rows, model.evidence.floor2
    residual2 = (model.fit.held_out_mse * rows).sum(axis=0)
    ratio2 = residual2 / (floor2 * rows).sum(axis=0)
    return {int(j) + 1 for j in np.flatnonzero(ratio2 >= COMPLIANCE_RATIO**2)}


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
