"""How sure a finding is: what supports it, its calibrated probability, and the alternatives that share the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.assessment.alternatives import (
    Alternative,
    alternatives,
    equivalents,
)
from gapscope.diagnosis.assessment.calibration import (
    Support,
    probability,
    with_probabilities,
)
from gapscope.diagnosis.assessment.excess_residual import ExcessResidual
from gapscope.diagnosis.assessment.held_out_prediction import HeldOutPredictor
from gapscope.diagnosis.selection.search import Selection
from gapscope.diagnosis.thresholds import ABOVE_FLOOR_NRMSE, CLOSING_JOINTS, TEMPER
from gapscope.model.terms import Term, count_findings


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
    support = _support(found, residual, finding, others)
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
    others: Sequence[Alternative],
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

    # Alternatives that are better than the effect count as equals.
    log_odds = [TEMPER * min(other.evidence, 0.0) for other in others]
    return Support(
        margin=float(-np.logaddexp.reduce([-700.0, *log_odds])),
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
