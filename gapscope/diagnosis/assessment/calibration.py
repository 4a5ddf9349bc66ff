"""Probability that an effect is named correctly, calibrated on blind cases that serve no other purpose.

Evidence compares effects with each other. It does not say how often the best of them is wrong: the true cause may be
missing from the catalogue, or another effect may take over a part of it. How often that happens is learnt,

    p = p_evidence / (1 + exp(-(b + w . x)))

with p_evidence the probability against the known alternatives and x the features of a finding's support.
``calibration.json`` holds b and w and names the script that fitted them.

What was learnt on simulated arms holds for arms like them. On a real arm a healthy model may leave far more than any of
them does, and nothing says what that does to a finding: z = log(left / most that was seen) is a feature whose weight is
as unknown as its prior says, variance V about zero. Averaged over that,

    p = p_evidence / (1 + exp(-(b + w . x) / sqrt(1 + pi V z^2 / 8)))        z >= 0            [mackay1992]
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.diagnosis.assessment.alternatives import Alternative
from gapscope.diagnosis.thresholds import (
    LEAST_PROBABILITY,
    LISTED_PROBABILITY,
    MOST_PROBABILITY,
    TEMPER,
)

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
        margin: log odds against all alternatives together, by evidence alone.
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
    return float(np.clip(calibrated, LEAST_PROBABILITY, MOST_PROBABILITY))


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
