"""What else could explain the gap: alternatives to each effect found, with probabilities.

Most alternatives are other causes, weighed by evidence. An exact equivalent is the same cause by another name: a load
on the last link, or that link changed, are one body. No data tell them apart, and what is common decides.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.selection.moves import near_equivalent_pairs
from gapscope.diagnosis.selection.search import Selection
from gapscope.diagnosis.thresholds import (
    LAST_LINK_ODDS,
    LOAD_FORM_ODDS,
    NEAR_EQUIVALENT_ODDS,
    TEMPER,
)
from gapscope.effects.catalogue import effect as by_name
from gapscope.model.terms import Term

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
    options = _options(selection, mine)
    evidence = _relative_evidence(selection, finding, mine, options)
    evidence |= _with_prior(finding, evidence)
    weights = _odds(evidence)
    total = 1.0 + sum(weights.values())
    ranked = sorted(evidence, key=lambda name: evidence[name], reverse=True)
    return [
        Alternative(
            effect=name,
            joints=_joints(options.get(name, frozenset())),
            probability=weights[name] / total,
            evidence=evidence[name],
        )
        for name in ranked
    ]


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


def _options(selection: Selection, mine: frozenset[Term]) -> dict[str, frozenset[Term]]:
    """Terms by which each effect of the catalogue could take the place of an effect's terms; empty sets left out."""
    found = selection.fit.terms
    of_last_link = any(t.changes_link(selection.last_link) for t in mine)
    joints = {t.joint for t in mine} - {0}
    named = {t.effect for t in found}
    options: dict[str, frozenset[Term]] = {NONE: frozenset()}
    for effect in selection.evidence.terms.definitions:
        # The joints do not say which link; an effect that is named already explains its part.
        if effect.scope == "link" or effect.name in named:
            continue
        terms = frozenset(
            t
            for t in selection.evidence.terms.open
            if t.effect == effect.name
            and (t.joint in joints or effect.scope == "arm" or not joints)
            # A load is the last link's other name, see equivalents.
            and not (of_last_link and t.is_load)
        )
        if terms:
            options[effect.name] = terms
    return options


def _relative_evidence(
    selection: Selection,
    finding: str,
    mine: frozenset[Term],
    options: Mapping[str, frozenset[Term]],
) -> dict[str, float]:
    """Evidence with each alternative instead of the terms, less that with the terms [nats]."""
    fit = selection.fit
    # The search has compared near-equivalents each around its own values: more exact than the linearisation here.
    compared = {
        other: evidence
        for (named, other), evidence in selection.contested.items()
        if named == finding
    }
    out = {}
    for name, terms in options.items():
        if name in compared:
            out[name] = compared[name]
        else:
            replaced = selection.evidence.fit((fit.terms - mine) | terms)
            out[name] = replaced.score - fit.score
    return out | compared


def _with_prior(finding: str, evidence: Mapping[str, float]) -> dict[str, float]:
    """Evidence of the rarer effect that equals the one found to first order, its odds before the data included [nats].

    The data hardly tell the two apart, and what is common decides.
    """
    prior = float(np.log(NEAR_EQUIVALENT_ODDS)) / TEMPER
    return {
        rare: min(evidence[rare], 0.0) + prior
        for common, rare in near_equivalent_pairs()
        if finding == common and rare in evidence
    }


def _odds(evidence: Mapping[str, float]) -> dict[str, float]:
    """Odds of each alternative against the effect named, at most 1: exp(tau evidence)."""
    return {
        name: float(np.exp(np.clip(TEMPER * nats, -700.0, 0.0)))
        for name, nats in evidence.items()
    }


def _joints(terms: frozenset[Term]) -> tuple[int, ...]:
    return tuple(sorted(t.joint for t in terms if t.joint))


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
