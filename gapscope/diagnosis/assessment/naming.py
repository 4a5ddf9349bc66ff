"""Named or possible: what has a calibrated probability of at least one half is named, what has less is possible."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from gapscope.diagnosis.assessment.confidence import Confidence, confidence, terms_of
from gapscope.diagnosis.assessment.excess_residual import ExcessResidual
from gapscope.diagnosis.assessment.held_out_prediction import HeldOutPredictor
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
        least = min(sure, key=lambda finding: sure[finding].probability, default=None)
        if least is None or sure[least].probability >= NAMED_PROBABILITY:
            return Naming(selection, sure, possible)
        possible[least] = sure[least]
        kept = selection.fit.terms - terms_of(selection, least)
        selection = replace(selection, fit=selection.evidence.fit_possible(kept))
        # what cannot be without it is no surer
        remaining = {t.finding for t in selection.fit.terms}
        for finding in sure.keys() - remaining - {least}:
            most = min(sure[finding].probability, sure[least].probability)
            possible[finding] = replace(sure[finding], probability=most)
