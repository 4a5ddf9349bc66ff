"""Named or possible: what has a calibrated probability of at least one half is named, what has less is possible.

A lag and a delay of a few milliseconds are near-equivalents, which share the probability of one cause. Where together
they have one half the gap is explained, and the name that was found stands; the other one is among its alternatives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from gapscope.diagnosis.assessment.confidence import Confidence, confidence, terms_of
from gapscope.diagnosis.assessment.excess_residual import ExcessResidual
from gapscope.diagnosis.assessment.held_out_prediction import HeldOutPredictor
from gapscope.diagnosis.selection.moves import near_equivalent
from gapscope.diagnosis.selection.search import Selection
from gapscope.diagnosis.thresholds import NAMED_PROBABILITY


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

    The least sure goes first, and the others are weighed anew without it: of two that do as well without each other,
    one stays.

    Args:
        found: with all findings.
        residual: what all of them leave. It counts to the end: a possible effect explains its part.
    """
    selection = found.selection
    possible: dict[str, Confidence] = {}
    while True:
        sure = {
            finding: confidence(found, residual, selection, finding)
            for finding in sorted({t.finding for t in selection.fit.terms})
        }
        shared = {finding: _of_either(finding, sure[finding]) for finding in sure}
        least = min(shared, key=lambda finding: shared[finding], default=None)
        if least is None or shared[least] >= NAMED_PROBABILITY:
            return Naming(selection, sure, possible)
        possible[least] = sure[least]
        kept = selection.fit.terms - terms_of(selection, least)
        selection = replace(selection, fit=selection.evidence.fit_possible(kept))
        # what cannot be without it is no surer
        remaining = {t.finding for t in selection.fit.terms}
        for finding in sure.keys() - remaining - {least}:
            most = min(sure[finding].probability, sure[least].probability)
            possible[finding] = replace(sure[finding], probability=most)


def _of_either(finding: str, sure: Confidence) -> float:
    """Probability of a finding, by its name or by that of its near-equivalent [1]."""
    other = near_equivalent(finding)
    return sure.probability + sum(
        rival.probability for rival in sure.alternatives if rival.effect == other
    )
