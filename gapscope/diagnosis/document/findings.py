"""Findings on the effects of a study: evidence, parameters, share, places and alternatives of each."""

from __future__ import annotations

from typing import Any

import numpy as np

from gapscope.diagnosis.assessment.alternatives import (
    Alternative,
    alternatives,
    separated_by,
)
from gapscope.diagnosis.assessment.calibration import (
    Support,
    conformal_set,
    probability,
    with_probabilities,
)
from gapscope.diagnosis.assessment.held_out_prediction import Share
from gapscope.diagnosis.assessment.significance import (
    false_discovery_rates,
    log_e_values,
)
from gapscope.diagnosis.document.entries import known_numbers, numbers, region_entry
from gapscope.diagnosis.document.parameters import finding_of, parameters
from gapscope.diagnosis.gap.torque_gap import TorqueGap
from gapscope.diagnosis.localisation.regimes import regions
from gapscope.diagnosis.localisation.stacked_rows import MotionRows
from gapscope.diagnosis.selection.resampling import bootstrap
from gapscope.diagnosis.study import Study
from gapscope.diagnosis.thresholds import (
    ABOVE_FLOOR_NRMSE,
    CLOSING_JOINTS,
    FALSE_DISCOVERY_RATE,
    TEMPER,
)
from gapscope.effects.applied import AppliedEffect

LISTED_ALTERNATIVE = 1e-3
"""Alternatives less probable than this are not listed."""


def effect_findings(study: Study, rows: MotionRows) -> list[dict[str, Any]]:
    """Findings on the effects, those with the largest share first."""
    selection = study.selection
    shares = study.predictor.shares()
    log_e = log_e_values(selection)
    rates = false_discovery_rates(log_e)
    rng = np.random.default_rng(0)
    draws = bootstrap(selection.evidence, selection.fit.terms, rng)
    instrumented = {finding_of(e): e for e in study.instrumented_effects}
    by_share = sorted(
        study.effects, key=lambda e: shares[finding_of(e)].value, reverse=True
    )
    findings = []
    for applied in by_share:
        name = finding_of(applied)
        findings.append(
            {
                **_finding(study, applied, rows),
                "parameters": parameters(
                    selection, applied, draws, instrumented.get(name)
                ),
                **_share_entry(shares[name]),
                **_significance_entry(log_e.get(name), rates.get(name)),
            }
        )
    return findings


def _share_entry(share: Share) -> dict[str, Any]:
    return {"share": share.value, "share_interval": [share.low, share.high]}


def _significance_entry(log_e: float | None, rate: float | None) -> dict[str, Any]:
    """Significance of an effect; all unknown for a compliant joint, which is not tested."""
    return {
        "log_e": log_e,
        "false_discovery_rate": rate,
        "confirmed": None if rate is None else rate <= FALSE_DISCOVERY_RATE,
    }


def _finding(study: Study, applied: AppliedEffect, rows: MotionRows) -> dict[str, Any]:
    """Probability, gaps, places and alternatives of an effect found."""
    name, terms = finding_of(applied), study.selection.fit.terms
    mine = frozenset(t for t in terms if t.finding == name)
    only, without = study.predictor.gap(mine), study.predictor.gap(terms - mine)
    _, others = alternatives(study.selection, name)
    support = _support(study, applied, without.nrmse, others)
    probable = probability(applied.name, support)
    others = with_probabilities(others, probable, support)
    return {
        "effect": applied.name,
        "joints": list(applied.joints),
        "probability": probable,
        "set": conformal_set(applied.name, probable, others),
        "support": support.plain(),
        "gap_with_only_this": {
            "torque_nrmse": numbers(only.nrmse),
            "replay_rmse": known_numbers(study.replay_gap.only.get(name)),
        },
        "gap_without_this": {
            "torque_nrmse": numbers(without.nrmse),
            "replay_rmse": known_numbers(study.replay_gap.without.get(name)),
        },
        "where": _where(study, applied, without, rows),
        "alternatives": [
            _alternative_entry(applied.name, other)
            for other in others
            if other.probability > LISTED_ALTERNATIVE
        ],
    }


def _support(
    study: Study,
    applied: AppliedEffect,
    without: np.ndarray,
    others: list[Alternative],
) -> Support:
    """What supports an effect found, on its joints; if it acts on the arm or a link, on those where it closes the gap.

    Args:
        study: with the effect.
        applied: the effect.
        without: torque NRMSE with all effects but this, (n,).
        others: its alternatives.
    """
    closed = without - study.gap_after.nrmse
    places = [joint - 1 for joint in applied.joints]
    if not places:
        closing = closed >= CLOSING_JOINTS * closed.max()
        places = [int(j) for j in np.flatnonzero(closing)]

    residual = study.excess_residual
    # A joint with hardly any gap before has no meaningful share of it left.
    before = np.maximum(residual.before[places], ABOVE_FLOOR_NRMSE)

    # Alternatives that are better than the effect count as equals.
    log_odds = [TEMPER * min(other.evidence, 0.0) for other in others]
    return Support(
        margin=float(-np.logaddexp.reduce([-700.0, *log_odds])),
        closed=float(closed.max()),
        left=float((residual.after[places] / before).max()),
        times_floor=float(residual.ratio[places].max()),
        effects=len(study.effects),
        nominal=study.selection.evidence.inertial_error,
    )


def _where(
    study: Study, applied: AppliedEffect, without: TorqueGap, rows: MotionRows
) -> list[dict[str, Any]]:
    """The region of each joint where an effect closes most; of an effect on many joints on the two it closes most."""
    closed2 = np.clip(without.error**2 - study.gap_after.error**2, 0.0, None)
    closed = np.sqrt(closed2)
    joints = list(applied.joints)
    if not joints:
        most_closed = np.argsort(-(closed**2).sum(axis=0))[:2]
        joints = [int(j) + 1 for j in most_closed]
    load = study.gap_before.predicted
    return [region_entry(r) for r in regions(closed, rows, load, joints, most=1)]


def _alternative_entry(effect: str, other: Alternative) -> dict[str, Any]:
    return {
        "effect": other.effect,
        "joints": list(other.joints),
        "probability": other.probability,
        "evidence": other.evidence,
        "separated_by": separated_by(effect, other.effect),
    }
