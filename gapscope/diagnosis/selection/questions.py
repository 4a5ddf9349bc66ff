"""Questions that the search asks by themselves: springs, load or link, a turned base."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gapscope.diagnosis.selection.fitted_model import (
    Model,
    closed_between,
    fit_terms,
    refine,
)
from gapscope.diagnosis.thresholds import (
    COMPLIANCE_RATIO,
    COMPLIANCE_START_GAIN,
    COMPLIANCE_START_SHARE,
    COMPLIANCE_STARTS_TRIED,
    LINK_OVER_PAYLOAD,
    MOVE_GAIN,
    VISIBLE_EFFECT,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import LinkChange, Transmission, Turn
from gapscope.model.gravity_direction import (
    TURNED_BASE_FALL,
    gravity_by_torque,
    turn_of_base,
)
from gapscope.model.terms import Term

# Compliant joints: found by what is simulated of them, each as elasticity or as backlash, and dropped if not needed.
#
# Elasticity twists in proportion to the torque, free play jumps where the torque changes its sign. A linearisation
# around no compliance shows neither. What each effect offers as starts is simulated on each joint and compared with
# what the model leaves; fits begin at the best, and the two are compared as fitted.


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


# Payload or changed last link: the same body, written in two ways.
#
# With m0, c0 mass and centre of the nominal last link, a change of them by dm and dc and a load of mass m at c are
# equal in mass and first moment for
#
#     m = dm,    m c = (m0 + dm) (c0 + dc) - m0 c0
#
# They differ in the moments of inertia that either form assumes, which a real load or link need not have. So the motion
# does not tell them apart: which of them it is, is a question of what is common.


def prefer_payload(model: Model) -> Model:
    """Take a payload instead of a changed last link, unless no load is the same body or the link is far better.

    No load is the same body if mass is missing. The link is far better if the evidence says so and a person sees it.
    """
    last = model.data.body.last_link + 1
    link = next((t for t in model.fit.terms if t.changes_link(last)), None)
    payload = next((t for t in model.terms.all if t.is_load), None)
    if link is None or payload is None or payload in model.fit.terms:
        return model
    load = _as_load(model, link)
    if load[0] <= 0:
        return model
    others = model.fit.terms - {link}
    # around values of the same body: from nothing a heavy load far out is not found beside another changed link
    starts = {t: model.fit.theta[list(t.columns)] for t in others} | {payload: load}
    loaded = fit_terms(model, others | {payload}, starts)
    if payload not in loaded.fit.terms:
        return model
    far_better = loaded.gain_of(model) > LINK_OVER_PAYLOAD
    if far_better and closed_between(loaded, model) >= VISIBLE_EFFECT:
        return model
    return loaded


def _as_load(model: Model, link: Term) -> np.ndarray:
    """Mass [kg] and first moment [kg m] of the load that is the same body as a changed last link, (4,)."""
    assert isinstance(link.definition, LinkChange)
    own = model.data.body.inertial_parameters().reshape(-1, 10)[link.joint - 1]
    (effect,) = model.terms.effects(model.fit.theta, [link])
    return link.definition.change(own, *effect.parameters.values())[:4]


# Arms that hang or are mounted otherwise: too far from the nominal arm's gravity for its linearisation.


def add_turned_base(nominal: Model) -> Model:
    """The model with the turn of the base that takes most of the gap away, if one does, of the effect's starts."""
    gravity = nominal.data.body.gravity
    upright = _gap_square(nominal, gravity)
    for term in nominal.terms.all:
        effect = term.definition
        if not isinstance(effect, Turn):
            continue
        turns = [*map(np.array, effect.far), *_fitted_turn(nominal)]
        gaps = [_gap_square(nominal, effect.rotation(*x).T @ gravity) for x in turns]
        best = int(np.argmin(gaps))
        if gaps[best] > (1.0 - TURNED_BASE_FALL) * upright:
            continue
        turned = fit_terms(nominal, frozenset({term}), {term: turns[best]})
        if nominal.gain_of(turned) > 0:
            return turned
    return nominal


def _fitted_turn(model: Model) -> list[np.ndarray]:
    """Roll and pitch [rad] of the base that gives the gravity which the torque shows, if any does."""
    data = model.data
    arm = CorrectedArm(data.arm)
    gravity = data.body.gravity
    torque, regressor, speed = [], [], []
    for segment, bodies in zip(data.segments, data.bodies, strict=True):
        assert segment.torque is not None
        predicted = arm.predict(segment.bodies(data.body), segment.motion)
        without_gravity = segment.torque - predicted + bodies.gravity @ gravity
        torque.append(data.thin(without_gravity, segment))
        regressor.append(data.thin(bodies.gravity, segment))
        speed.append(data.thin(segment.motion.dq, segment))
    found = gravity_by_torque(
        np.concatenate(torque),
        np.concatenate(regressor),
        np.concatenate(speed),
        data.torque_deviation,
    )
    turn = turn_of_base(gravity, found)
    return [] if turn is None else [np.array(turn)]


def _gap_square(model: Model, gravity: np.ndarray) -> float:
    """Squared gap of the nominal arm under another gravity, over that of the torques, summed over rows [1]."""
    data = model.data
    arm = CorrectedArm(data.arm)
    change = gravity - data.body.gravity
    total = 0.0
    for segment, bodies in zip(data.segments, data.bodies, strict=True):
        assert segment.torque is not None
        predicted = arm.predict(segment.bodies(data.body), segment.motion)
        gap = segment.torque - predicted - bodies.gravity @ change
        scaled = data.thin(gap, segment) / data.torque_deviation
        total += float((scaled**2).sum())
    return total
