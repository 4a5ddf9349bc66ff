"""How sure a name is: probability, its calibration, and what it may be instead."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.diagnosis.assessment.held_out_prediction import (
    ExcessResidual,
    HeldOutPredictor,
)
from gapscope.diagnosis.selection.fitted_model import Selection
from gapscope.diagnosis.thresholds import (
    ABOVE_FLOOR_NRMSE,
    CLOSING_JOINTS,
    LAST_LINK_ODDS,
    LISTED_PROBABILITY,
    LOAD_FORM_ODDS,
    MAX_PROBABILITY,
    MIN_PROBABILITY,
    NAMED_PROBABILITY,
    TEMPER,
)
from gapscope.effects.catalogue import effect as by_name
from gapscope.model.terms import Term, count_findings

# What else could explain the gap: alternatives to each effect found, with probabilities.
#
# Most alternatives are other causes, weighed by evidence. An exact equivalent is the same cause by another name: a load
# on the last link, or that link changed, are one body. No data tell them apart, and what is common decides.


NONE = "none"
"""Name of the alternative that nothing takes the effect's place."""

LONGER_RECORDING = "a longer recording with more of the motion on which the effect acts"
"""What separates an effect from none."""


@dataclass(frozen=True)
class Alternative:
    """An effect in the place of another.

    Attributes:
        effect: its name; ``none`` if nothing takes the place.
        joints: its joints.
        probability: probability that it, and not the effect named, is the cause.
        evidence: its evidence less that of the effect named, odds before the data included [nats].
        equivalent: whether it is the same cause by another name.
    """

    effect: str
    joints: tuple[int, ...]
    probability: float
    evidence: float
    equivalent: bool = False


def alternatives(selection: Selection, finding: str) -> list[Alternative]:
    """Other causes in the place of an effect found, by evidence alone, in falling order of probability."""
    mine = frozenset(t for t in selection.fit.terms if t.finding == finding)
    evidence = _in_its_place(selection, mine)
    weights = _odds(evidence)
    total = 1.0 + sum(weights.values())
    ranked = sorted(evidence, key=lambda name: evidence[name], reverse=True)
    joints = tuple(sorted({t.joint for t in mine} - {0}))
    return [
        Alternative(
            effect=name,
            joints=joints if name != NONE and by_name(name).scope == "joint" else (),
            probability=weights[name] / total,
            evidence=evidence[name],
        )
        for name in ranked
    ]


def _in_its_place(selection: Selection, mine: frozenset[Term]) -> dict[str, float]:
    """Evidence of the sets that compete with other terms in the place of an effect's, over that with these [nats].

    A search exchanges the terms of an effect one by one: what its joints lose by that adds up.
    """
    found, sets = selection.fit.terms, selection.competing
    here = sets.get(found, 0.0)
    named = {t.effect for t in found}
    out: dict[str, float] = {}
    one_by_one: dict[str, dict[Term, float]] = {NONE: {}}
    for some, value in sets.items():
        lost, put = found - some, some - found
        names = {t.effect for t in put} or {NONE}
        if not lost or not lost <= mine or len(names) > 1:
            continue
        (name,) = names
        if not all(_stands_for(selection, t, lost, named) for t in put):
            continue
        if lost == mine:
            out[name] = max(value - here, out.get(name, -np.inf))
        elif len(lost) == 1:
            (term,) = lost
            by_term = one_by_one.setdefault(name, {})
            by_term[term] = max(value - here, by_term.get(term, -np.inf))
    without = one_by_one[NONE]
    for name, by_term in one_by_one.items():
        each = [by_term.get(t, without.get(t, -np.inf)) for t in mine]
        if by_term and name not in out and np.isfinite(each).all():
            out[name] = float(sum(each))
    return out


def _stands_for(
    selection: Selection, term: Term, lost: frozenset[Term], named: Collection[str]
) -> bool:
    """Whether a term may take the place of others: it acts on a joint of theirs or on all, and has no name yet."""
    # the joints do not say which link; an effect that is named already explains its part
    if term.definition.scope == "link" or term.effect in named:
        return False
    # a load is the last link's other name, see equivalents
    if term.is_load and any(t.changes_link(selection.last_link) for t in lost):
        return False
    joints = {t.joint for t in lost} - {0}
    return not (term.joint and joints) or term.joint in joints


def equivalents(selection: Selection, finding: str) -> list[Alternative]:
    """Other names of an effect found, each with its odds against the name given.

    A load is far more common than a changed last link. That link is named only if the motion speaks against a load of
    this form, which a real load need not have, or if mass is missing, which is a load only if the URDF contains one.
    """
    every = selection.evidence.terms.all
    load = next((t for t in every if t.is_load), None)
    link = next((t for t in every if t.changes_link(selection.last_link)), None)
    if load is None or link is None:
        return []
    if finding == load.finding:
        return [_equivalent(link.effect, LAST_LINK_ODDS)]
    if finding != link.finding:
        return []
    mass_is_missing = selection.fit.theta[link.columns[0]] <= 0
    odds = LAST_LINK_ODDS if mass_is_missing else LOAD_FORM_ODDS
    return [_equivalent(load.effect, odds)]


def _equivalent(effect: str, odds: float) -> Alternative:
    evidence = float(np.log(odds)) / TEMPER
    return Alternative(effect, (), odds / (1.0 + odds), evidence, equivalent=True)


def _odds(evidence: Mapping[str, float]) -> dict[str, float]:
    """Odds of each alternative against the effect named, at most 1: exp(tau evidence)."""
    return {
        name: float(np.exp(np.clip(TEMPER * nats, -700.0, 0.0)))
        for name, nats in evidence.items()
    }


def separated_by(effect: str, alternative: Alternative) -> str:
    """What separates an effect found from an alternative, in words."""
    if alternative.equivalent:
        return (
            "no motion, as both are the same body: by looking at what the arm carries"
        )
    return _recording_between(effect, alternative.effect)


def _recording_between(effect: str, alternative: str) -> str:
    if alternative == NONE:
        return LONGER_RECORDING
    for one, other in ((effect, alternative), (alternative, effect)):
        for name, recording in by_name(one).confused_with:
            if name == other:
                return recording
    return "the same path at half and at double speed, and with a known payload"


# Probability that an effect is named correctly, calibrated on blind cases that serve no other purpose.
#
# Evidence compares effects with each other. It does not say how often the best of them is wrong: the true cause may be
# missing from the catalogue, or another effect may take over a part of it. How often that happens is learnt,
#
#     p = p_evidence / (1 + exp(-(b + w . x)))
#
# with p_evidence the probability against the known alternatives and x the features of a finding's support.
# ``calibration.json`` holds b and w and names the script that fitted them.
#
# What was learnt on simulated arms holds for arms like them. On a real arm a healthy model may leave far more than
# any of them does, and nothing says what that does to a finding: z = log(left / most that was seen) is a feature
# whose weight is as unknown as its prior says, variance V about zero. Averaged over that,
#
#     p = p_evidence / (1 + exp(-(b + w . x) / sqrt(1 + pi V z^2 / 8)))        z >= 0            [mackay1992]


FILE = Path(__file__).with_name("calibration.json")
"""The fitted values."""
WEIGHT_PRECISION = 0.3
"""Prior precision of the weights."""
UNSEEN_VARIANCE = 1.0 / WEIGHT_PRECISION
"""V: variance of a weight that no case tells."""


@dataclass(frozen=True)
class Support:
    """What supports a finding.

    Attributes:
        margin: log odds of the sets that compete with it over those without, by evidence alone.
        closed: torque NRMSE that it closes on the joint where it closes most.
        left: share of the gap above the floor that remains on its joints, the largest of them.
        times_floor: what remains there over the floor, the largest of them.
        times_expected: the same over what a healthy arm of this kind leaves, learnt from the data.
        effects: number of effects named.
        nominal: relative error of the nominal inertials.
        expected: torque NRMSE that a healthy arm of this kind leaves there, the largest of its joints.
    """

    margin: float
    closed: float
    left: float
    times_floor: float
    times_expected: float
    effects: int
    nominal: float
    expected: float = 0.0

    @property
    def evidence(self) -> float:
        """Probability against all alternatives together, by evidence alone."""
        return float(1.0 / (1.0 + np.exp(-np.clip(self.margin, -50.0, 50.0))))

    def features(self) -> np.ndarray:
        """The numbers that the probability depends on, each about 0 to 3."""
        # Logarithms of what varies by orders of magnitude; bounds where more of it says nothing new.
        margin = np.log1p(np.clip(self.margin, 0.0, 200.0)) / 2
        closed = np.clip(np.log(max(self.closed, 1e-4) / 0.01), -1.0, 3.0)
        # What is left speaks for a cause that is missing, if it is more than a healthy arm of this kind leaves.
        left = np.clip(self.left, 0.0, 1.0)
        times = np.clip(np.log(max(self.times_expected, 1e-3)), 0.0, 2.0)

        # Many effects may stand in for one that is missing, and poor inertials look like many effects.
        other_effects = min(self.effects - 1, 4)
        poor_inertials = float(self.nominal > 0.02)

        return np.array([margin, closed, left, times, other_effects, poor_inertials])

    def plain(self) -> dict[str, float]:
        """As plain numbers for JSON."""
        return {name: float(value) for name, value in asdict(self).items()}


@cache
def fitted() -> Mapping[str, Any]:
    """The fitted values.

    ``intercept``, ``weights``, ``effects`` with a number each, ``level`` of the sets, and ``expected``, the most that a
    healthy arm left on 19 of 20 findings.
    """
    return dict(json.loads(FILE.read_text(encoding="utf-8")))


def probability(
    effect: str, support: Support, values: Mapping[str, Any] | None = None
) -> float:
    """Probability that an effect with this support is a true cause, on these joints or others."""
    values = fitted() if values is None else values
    learnt = float(np.dot(values["weights"], support.features()))
    logit = values["intercept"] + learnt + values["effects"].get(effect, 0.0)

    # What no arm of the calibration was like is not known to count for the finding, nor against it.
    beyond = max(np.log(max(support.expected, 1e-9) / values["expected"]), 0.0)
    logit /= np.sqrt(1.0 + np.pi * UNSEEN_VARIANCE * beyond**2 / 8.0)

    # Both have to hold: the effect beats its alternatives, and the true cause is among them.
    calibrated = support.evidence / (1.0 + np.exp(-logit))
    return float(np.clip(calibrated, MIN_PROBABILITY, MAX_PROBABILITY))


def with_probabilities(
    alternatives: Sequence[Alternative],
    probability: float,
    support: Support,
    values: Mapping[str, Any] | None = None,
) -> list[Alternative]:
    """Alternatives with their share of the probability that an effect named leaves, in falling order.

    The effect named may be wrong for two reasons, and its probability is a product of both. What evidence leaves is
    shared by evidence. What calibration takes beyond that is shared by evidence that counts less, and a cause that is
    not listed takes a part of it, so that the sum over all alternatives stays below the remaining probability.

    Args:
        alternatives: with their evidence relative to the effect named.
        probability: of the effect named.
        support: of the effect named.
        values: the fitted ones if ``None``.
    """
    values = fitted() if values is None else values
    cause_is_known = min(probability / support.evidence, 1.0)
    relative = np.minimum([other.evidence for other in alternatives], 0.0)

    # The cause is among those compared: the effect named has odds 1.
    odds = np.exp(TEMPER * relative)
    by_evidence = odds / (1.0 + odds.sum())
    # The effect named is wrong for another reason: evidence has misled, and says less of the others.
    milder_odds = np.exp(values["temper"] * relative)
    by_default = milder_odds / (milder_odds.sum() + values["unlisted"])

    chances = cause_is_known * by_evidence + (1.0 - cause_is_known) * by_default
    out = [
        replace(other, probability=float(chance))
        for other, chance in zip(alternatives, chances, strict=True)
    ]
    return sorted(out, key=lambda other: -other.probability)


def conformal_set(
    effect: str, probability: float, alternatives: Sequence[Alternative]
) -> list[str]:
    """Names that hold the true one in nine cases of ten: in falling order until they reach the conformal level.

    If those listed do not reach it, ``unknown`` takes the rest.
    """
    level = fitted()["level"]
    names, total = [effect], probability

    for other in alternatives:
        if total >= level or other.probability < LISTED_PROBABILITY:
            break
        names.append(other.effect)
        total += other.probability

    if total < level:
        names.append("unknown")
    return names


# How sure a finding is: what supports it, its calibrated probability, and the alternatives that share the rest.


@dataclass(frozen=True)
class Confidence:
    """How sure a finding is.

    Attributes:
        probability: that it is a true cause, by the name given [1].
        support: what the probability depends on.
        alternatives: other causes and other names with their probabilities, in falling order.
    """

    probability: float
    support: Support
    alternatives: list[Alternative]


def terms_of(selection: Selection, finding: str) -> frozenset[Term]:
    """The terms of a selection that are named with one finding."""
    return frozenset(t for t in selection.fit.terms if t.finding == finding)


def confidence(
    found: HeldOutPredictor,
    residual: ExcessResidual,
    selection: Selection,
    finding: str,
) -> Confidence:
    """How sure a finding is.

    Args:
        found: with all findings.
        residual: what all of them leave.
        selection: those that are weighed against their alternatives.
        finding: one of these.
    """
    others = alternatives(selection, finding)
    support = _support(found, residual, finding)
    name = next(iter(terms_of(selection, finding))).effect
    cause = probability(name, support)
    ranked = with_probabilities(others, cause, support)
    return _by_names(cause, support, ranked, equivalents(selection, finding))


def _by_names(
    cause: float,
    support: Support,
    others: Sequence[Alternative],
    names: Sequence[Alternative],
) -> Confidence:
    """The probability of a cause shared by the name given and its exact equivalents, by their odds."""
    odds = [float(np.exp(TEMPER * name.evidence)) for name in names]
    given = cause / (1.0 + sum(odds))
    shared = [
        Alternative(name.effect, (), given * odd, name.evidence, equivalent=True)
        for name, odd in zip(names, odds, strict=True)
    ]
    ranked = sorted([*shared, *others], key=lambda other: -other.probability)
    return Confidence(given, support, ranked)


def _support(
    found: HeldOutPredictor,
    residual: ExcessResidual,
    finding: str,
) -> Support:
    """What supports a finding, on its joints; if it acts on more, on those where it closes the gap."""
    terms = found.selection.fit.terms
    mine = terms_of(found.selection, finding)
    closed = found.gap(terms - mine).nrmse - found.gap(terms).nrmse
    on_joints = [t for t in mine if t.definition.scope == "joint"]
    places = sorted(t.joint - 1 for t in on_joints if t.definition.reach != "motor")
    if not places:
        closing = closed >= CLOSING_JOINTS * closed.max()
        places = [int(j) for j in np.flatnonzero(closing)]

    # A joint with hardly any gap before has no meaningful share of it left.
    before = np.maximum(residual.before[places], ABOVE_FLOOR_NRMSE)

    return Support(
        margin=TEMPER * found.selection.log_odds(mine),
        closed=float(closed.max()),
        left=float((residual.after[places] / before).max()),
        times_floor=float(residual.ratio[places].max()),
        times_expected=float(residual.ratio_expected[places].max()),
        effects=count_findings(terms),
        nominal=float(found.selection.evidence.inertial_error),
        expected=float(_expected(found.selection)[places].max()),
    )


def _expected(selection: Selection) -> np.ndarray:
    """Torque NRMSE that a healthy arm leaves of every model, (n,)."""
    healthy = np.sqrt(selection.evidence.expected2.mean(axis=0))
    return np.asarray(healthy / selection.scale)


# Named or possible: what has a calibrated probability of at least one half is named, what has less is possible.


@dataclass(frozen=True)
class Naming:
    """Findings divided by how sure they are.

    Attributes:
        selection: with what is named alone.
        named: how sure each finding is that is named, by its name.
        possible: how sure each finding is that is possible, the least sure first.
    """

    selection: Selection
    named: Mapping[str, Confidence]
    possible: Mapping[str, Confidence]


def divide(found: HeldOutPredictor, residual: ExcessResidual) -> Naming:
    """Divide findings into named and possible ones.

    Args:
        found: with all findings.
        residual: what all of them leave: a possible effect explains its part.
    """
    selection = found.selection
    terms = selection.fit.terms
    sure = {
        finding: confidence(found, residual, selection, finding)
        for finding in sorted({t.finding for t in terms})
    }
    named = {f for f, own in sure.items() if own.probability >= NAMED_PROBABILITY}
    if len(named) < len(sure):
        kept = frozenset(t for t in terms if t.finding in named)
        selection = replace(selection, fit=selection.evidence.fit_possible(kept))
    # what cannot be without a doubtful one is no surer
    doubtful = [own.probability for f, own in sure.items() if f not in named]
    named &= {t.finding for t in selection.fit.terms}
    possible = {
        f: replace(own, probability=min(own.probability, max(doubtful)))
        for f, own in sure.items()
        if f not in named
    }
    ranked = sorted(possible, key=lambda f: possible[f].probability)
    return Naming(
        selection,
        {f: sure[f] for f in sure if f in named},
        {f: possible[f] for f in ranked},
    )
