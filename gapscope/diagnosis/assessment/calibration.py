"""Probability that an effect is named rightly, calibrated on blind cases that were made for nothing else.

Evidence compares effects with each other, and says nothing of how often the best of them is wrong: the true cause may
be in no catalogue, another effect may stand for a part of it. How often that happens is learnt,

    p = p_evidence / (1 + exp(-(b + w . x)))

with p_evidence the probability against the rivals known, from the support x of each finding; ``calibration.json`` holds
b and w, and the script that fitted them is named in it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.diagnosis.assessment.alternatives import Rival
from gapscope.diagnosis.thresholds import (
    LEAST_PROBABILITY,
    LISTED_PROBABILITY,
    MOST_PROBABILITY,
    TEMPER,
)

FILE = Path(__file__).with_name("calibration.json")
"""The fitted values."""


@dataclass(frozen=True)
class Support:
    """What speaks for a finding.

    Attributes:
        margin: log odds against all rivals together, by evidence alone.
        closed: torque NRMSE that it closes on the joint where it closes most.
        left: share of the gap above the floor that is left on its joints, where most is left.
        times_floor: what is left on them over the floor.
        effects: number of effects named.
        nominal: relative error of the nominal inertials.
    """

    margin: float
    closed: float
    left: float
    times_floor: float
    effects: int
    nominal: float

    @property
    def evidence(self) -> float:
        """Probability against all rivals together, by evidence alone."""
        return float(1.0 / (1.0 + np.exp(-np.clip(self.margin, -50.0, 50.0))))

    def features(self) -> np.ndarray:
        """The numbers that the probability depends on, each about 0 to 3."""
        return np.array(
            [
                np.log1p(np.clip(self.margin, 0.0, 200.0)) / 2,
                np.clip(np.log(max(self.closed, 1e-4) / 0.01), -1.0, 3.0),
                np.clip(self.left, 0.0, 1.0),
                np.clip(np.log(max(self.times_floor, 1e-3)), 0.0, 2.0),
                min(self.effects - 1, 4),
                float(self.nominal > 0.02),
            ]
        )

    def plain(self) -> dict[str, float]:
        """As JSON knows it."""
        return {name: float(value) for name, value in asdict(self).items()}


@cache
def fitted() -> Mapping[str, Any]:
    """The fitted values: ``intercept``, ``weights``, ``effects`` with a number each, ``level`` of the sets."""
    return dict(json.loads(FILE.read_text(encoding="utf-8")))


def probability(
    effect: str, support: Support, values: Mapping[str, Any] | None = None
) -> float:
    """Probability that an effect with this support is a true cause, on the joints or not."""
    values = fitted() if values is None else values
    z = (
        values["intercept"]
        + float(np.dot(values["weights"], support.features()))
        + values["effects"].get(effect, 0.0)
    )
    return float(
        np.clip(
            support.evidence / (1.0 + np.exp(-z)), LEAST_PROBABILITY, MOST_PROBABILITY
        )
    )


def shared(
    rivals: Sequence[Rival],
    sure: float,
    support: Support,
    values: Mapping[str, Any] | None = None,
) -> list[Rival]:
    """Rivals with the probability that an effect named leaves, in falling order, less what no rival listed gets.

    What evidence leaves goes to them by evidence; what is learnt to be wrong beyond that, by evidence that counts less.

    Args:
        rivals: with their evidence relative to the effect named.
        sure: probability of the effect named.
        support: of the effect named.
        values: the fitted ones where ``None``.
    """
    values = fitted() if values is None else values
    known = min(sure / support.evidence, 1.0)
    relative = np.minimum([rival.evidence for rival in rivals], 0.0)
    close, far = (np.exp(temper * relative) for temper in (TEMPER, values["temper"]))
    by_evidence = close / (1.0 + close.sum())
    by_default = far / (far.sum() + values["unlisted"])
    chances = known * by_evidence + (1.0 - known) * by_default
    out = [
        replace(rival, probability=float(p))
        for rival, p in zip(rivals, chances, strict=True)
    ]
    return sorted(out, key=lambda rival: -rival.probability)


def conformal_set(
    effect: str, probability: float, rivals: Sequence[Rival]
) -> list[str]:
    """Names that hold the true one in nine cases of ten: in falling order until they reach the conformal level.

    Where those that count do not reach it, ``unknown`` stands for the rest.
    """
    names, total = [effect], probability
    for rival in rivals:
        if total >= fitted()["level"] or rival.probability < LISTED_PROBABILITY:
            break
        names.append(rival.effect)
        total += rival.probability
    return names if total >= fitted()["level"] else [*names, "unknown"]
