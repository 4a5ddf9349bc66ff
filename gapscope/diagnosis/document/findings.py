"""Findings on the effects of a study: evidence, parameters, share, places and alternatives of each."""

from __future__ import annotations

from typing import Any

import numpy as np

from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.assessment.alternatives import (
    LONGER_RECORDING,
    Alternative,
    separated_by,
)
from gapscope.diagnosis.assessment.calibration import conformal_set
from gapscope.diagnosis.assessment.confidence import terms_of
from gapscope.diagnosis.assessment.held_out_prediction import HeldOutPredictor, Share
from gapscope.diagnosis.assessment.significance import (
    false_discovery_rates,
    log_e_values,
)
from gapscope.diagnosis.document.entries import known_numbers, numbers, region_entry
from gapscope.diagnosis.document.parameters import finding_of, parameters
from gapscope.diagnosis.localisation.regimes import regions
from gapscope.diagnosis.localisation.stacked_rows import MotionRows
from gapscope.diagnosis.selection.value_draws import value_draws
from gapscope.diagnosis.study import Study
from gapscope.diagnosis.thresholds import FALSE_DISCOVERY_RATE
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.effect import Turn
from gapscope.model.torque_gap import TorqueGap

LISTED_ALTERNATIVE = 1e-3
"""Alternatives less probable than this are not listed."""


def effect_findings(study: Study, rows: MotionRows) -> list[dict[str, Any]]:
    """Findings on the effects named, those with the largest share first."""
    return _findings(study, study.predictor, study.effects, rows)


def possible_findings(study: Study, rows: MotionRows) -> list[dict[str, Any]]:
    """Findings on the effects that are possible only, beside all others, each with what would settle it."""
    findings = _findings(study, study.found, study.possible, rows)
    return [{**finding, "settled_by": _settled_by(finding)} for finding in findings]


def _findings(
    study: Study,
    predictor: HeldOutPredictor,
    effects: tuple[AppliedEffect, ...],
    rows: MotionRows,
) -> list[dict[str, Any]]:
    """Findings on some of the effects of a predictor's selection, those with the largest share first."""
    if not effects:
        return []
    selection = predictor.selection
    shares = predictor.shares()
    log_e = log_e_values(selection)
    rates = false_discovery_rates(log_e)
    rng = np.random.default_rng(0)
    draws = value_draws(selection.evidence, selection.fit.terms, rng)
    instrumented = {finding_of(e): e for e in study.instrumented_effects}
    by_share = sorted(effects, key=lambda e: shares[finding_of(e)].value, reverse=True)
    findings = []
    for applied in by_share:
        name = finding_of(applied)
        findings.append(
            {
                **_finding(study, predictor, applied, rows),
                "parameters": parameters(
                    selection, applied, draws, instrumented.get(name)
                ),
                **_share_entry(shares[name]),
                **_significance_entry(log_e.get(name), rates.get(name)),
            }
        )
    return findings


def _settled_by(finding: dict[str, Any]) -> str:
    """The recording that separates a possible effect from its likeliest alternative."""
    others = [o for o in finding["alternatives"] if not o.get("equivalent")]
    if others:
        return str(others[0]["separated_by"])
    return LONGER_RECORDING


def _share_entry(share: Share) -> dict[str, Any]:
    return {"share": share.value, "share_interval": [share.low, share.high]}


def _significance_entry(log_e: float | None, rate: float | None) -> dict[str, Any]:
    """Significance of an effect; all unknown for a compliant joint, which is not tested."""
    return {
        "log_e": log_e,
        "false_discovery_rate": rate,
        "confirmed": None if rate is None else rate <= FALSE_DISCOVERY_RATE,
    }


def _finding(
    study: Study,
    predictor: HeldOutPredictor,
    applied: AppliedEffect,
    rows: MotionRows,
) -> dict[str, Any]:
    """Probability, gaps, places and alternatives of an effect found."""
    name, terms = finding_of(applied), predictor.selection.fit.terms
    mine = terms_of(predictor.selection, name)
    only, without = predictor.gap(mine), predictor.gap(terms - mine)
    sure = study.confidences[name]
    return {
        "effect": applied.name,
        "joints": list(applied.joints),
        **_gravity(applied, study.case.arm),
        "probability": sure.probability,
        "set": conformal_set(applied.name, sure.probability, sure.alternatives),
        "support": sure.support.plain(),
        "gap_with_only_this": {
            "torque_nrmse": numbers(only.nrmse),
            "replay_rmse": known_numbers(study.replay_gap.only.get(name)),
        },
        "gap_without_this": {
            "torque_nrmse": numbers(without.nrmse),
            "replay_rmse": known_numbers(study.replay_gap.without.get(name)),
        },
        "where": _where(applied, predictor, without, rows),
        "alternatives": [
            alternative_entry(applied.name, other)
            for other in sure.alternatives
            if other.probability > LISTED_ALTERNATIVE
        ],
    }


def _gravity(applied: AppliedEffect, arm: NominalArm) -> dict[str, Any]:
    """Gravity in the frame of a base that is turned, R^T g [m/s^2]: what a case file says it as."""
    effect = CATALOGUE.get(applied.name)
    if not isinstance(effect, Turn):
        return {}
    angles = (float(np.ravel(applied.parameters[name])[0]) for name in effect.names)
    return {"gravity": numbers(effect.rotation(*angles).T @ arm.gravity)}


def _where(
    applied: AppliedEffect,
    predictor: HeldOutPredictor,
    without: TorqueGap,
    rows: MotionRows,
) -> list[dict[str, Any]]:
    """The region of each joint where an effect closes most; of an effect on many joints on the two it closes most."""
    with_all = predictor.gap(predictor.selection.fit.terms)
    closed2 = np.clip(without.error**2 - with_all.error**2, 0.0, None)
    closed = np.sqrt(closed2)
    joints = list(applied.joints)
    if not joints:
        most_closed = np.argsort(-(closed**2).sum(axis=0))[:2]
        joints = [int(j) + 1 for j in most_closed]
    load = predictor.gap(frozenset()).predicted
    return [region_entry(r) for r in regions(closed, rows, load, joints, most=1)]


def alternative_entry(effect: str, other: Alternative) -> dict[str, Any]:
    """An alternative to an effect as the document holds it."""
    return {
        "effect": other.effect,
        "joints": list(other.joints),
        "probability": other.probability,
        "evidence": other.evidence,
        "separated_by": separated_by(effect, other),
        "equivalent": other.equivalent,
    }
