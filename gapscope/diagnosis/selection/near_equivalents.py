"""Effects that look alike to first order, compared each around its own values.

Two that make the torque late by T, a delay and a lag, differ in the second order. With n the torque that the joint
needs, recorded is n + T dn/dt + a T^2 d2n/dt2 + b T^3 d3n/dt3, with a and b of ``Path.late_forms``; each form of the
rarer effect is compared with the more common one around that one's own values, the time T free on every joint.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from gapscope.diagnosis.selection.fitted_model import Model, fit_terms
from gapscope.diagnosis.selection.moves import near_equivalent_pairs
from gapscope.diagnosis.selection.visibility import nrmse
from gapscope.diagnosis.thresholds import (
    DECISIVE_EVIDENCE,
    DECISIVE_NRMSE,
    LONGEST_COMPARED_DELAY,
    UNDECIDED_EVIDENCE,
)
from gapscope.effects.catalogue import effect as by_name
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Path
from gapscope.model.terms import Term


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
    put = {t for t in model.terms.open if t.effect == other and t.joint in joints}
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
