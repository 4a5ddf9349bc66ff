"""What else could explain the gap: rivals of each effect found, with probabilities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.model.terms import Term
from gapscope.diagnosis.selection.search import Selection
from gapscope.diagnosis.thresholds import TEMPER
from gapscope.effects.catalogue import CATALOGUE, explained


@dataclass(frozen=True)
class Rival:
    """An effect in the place of another.

    Attributes:
        effect: its name; ``none`` for leaving the place empty.
        joints: its joints.
        probability: probability that it, and not the effect named, is the cause.
        evidence: its evidence less that of the effect named [nats].
    """

    effect: str
    joints: tuple[int, ...]
    probability: float
    evidence: float


def rivals(search: Selection, finding: str) -> tuple[float, list[Rival]]:
    """Probability of an effect found by evidence alone, and its rivals in falling order of probability."""
    evidence, found = search.evidence, search.fit
    mine = frozenset(t for t in found.terms if t.finding == finding)
    joints = {t.joint for t in mine} - {0}
    options: dict[str, frozenset[Term]] = {"none": frozenset()}
    for name in (e.name for e in explained()):
        same = [
            t for t in evidence.terms.open if t.effect == name and t not in found.terms
        ]
        scope = CATALOGUE[name].scope
        if scope == "link" or any(t.effect == name for t in found.terms):
            continue
        options[name] = frozenset(
            t for t in same if t.joint in joints or scope == "arm" or not joints
        )
    scores = {}
    for name, terms in options.items():
        if name == "none" or terms:
            known = search.contested.get((finding, name))
            scores[name] = (
                evidence.fit((found.terms - mine) | terms).score - found.score
                if known is None
                else known
            )
    for (named, name), score in search.contested.items():
        if named == finding and name not in scores:
            options[name], scores[name] = frozenset(), score
    weights = {
        name: float(np.exp(np.clip(TEMPER * score, -700, 0)))
        for name, score in scores.items()
    }
    total = 1.0 + sum(weights.values())
    ranked = sorted(scores, key=lambda name: scores[name], reverse=True)
    return 1.0 / total, [
        Rival(
            name,
            tuple(sorted(t.joint for t in options[name] if t.joint)),
            weights[name] / total,
            scores[name],
        )
        for name in ranked
    ]


def separated_by(effect: str, rival: str) -> str:
    """The recording that separates two effects, in words."""
    if rival == "none":
        return "a longer recording with more of the motion on which the effect acts"
    for one, other in ((effect, rival), (rival, effect)):
        for name, recording in CATALOGUE[one].confused_with:
            if name == other:
                return recording
    return "the same path at half and at double speed, and with a known payload"
