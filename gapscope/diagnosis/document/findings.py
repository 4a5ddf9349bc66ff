"""The content of ``diagnosis.json``: findings read from a study of a case."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from gapscope.diagnosis.assessment.alternatives import rivals, separated_by
from gapscope.diagnosis.assessment.calibration import (
    Support,
    conformal_set,
    probability,
    shared,
)
from gapscope.diagnosis.assessment.predictable_share import predictable
from gapscope.diagnosis.assessment.sensor_sides import described
from gapscope.diagnosis.assessment.significance import (
    false_discovery_rates,
    log_e_values,
)
from gapscope.diagnosis.document.context import context
from gapscope.diagnosis.document.parameters import finding_of, parameters
from gapscope.diagnosis.document.wording import effect_name
from gapscope.diagnosis.gap.torque_gap import torque_scale
from gapscope.diagnosis.localisation.regimes import located, regions
from gapscope.diagnosis.localisation.region import Region
from gapscope.diagnosis.localisation.stacked_rows import Rows, stack
from gapscope.diagnosis.thresholds import (
    ABOVE_FLOOR_NRMSE,
    CLOSING_JOINTS,
    FALSE_DISCOVERY_RATE,
    OPEN_ALTERNATIVE,
    PREDICTABLE_SHARE,
    SIGNIFICANT_RESIDUAL_RATIO,
    TEMPER,
)
from gapscope.effects.applied import AppliedEffect

if TYPE_CHECKING:
    from gapscope.diagnosis.diagnose import Study


def document(study: Study) -> dict[str, Any]:
    """``diagnosis.json`` of a study, without NaN, as plain Python values."""
    floor = study.floor / torque_scale(study.before.measured)
    rows = stack(study.predictor.segments)
    effects = _effects(study, rows)
    above = study.left.above
    before, after = study.before.nrmse, study.after.nrmse
    faulty = next(
        (f.gap_before for f in study.faults if f.gap_before is not None), None
    )
    total = study.before.nrmse if faulty is None else faulty
    effects = _with_faults(study, effects, total, after, floor)
    open_joints = [int(j) + 1 for j in np.flatnonzero(above)]
    told = predictable(study.after, rows, study.floor, open_joints)
    plain = any(
        p.share >= PREDICTABLE_SHARE
        or study.left.ratio[p.joint - 1] >= SIGNIFICANT_RESIDUAL_RATIO
        for p in told
    )
    verdict = _verdict(study, bool(effects), faulty, plain)
    return {
        "schema": 1,
        "case": study.case.name,
        "verdict": verdict,
        "gap": {
            "replayed": study.replay.by,
            "before": {
                "torque_nrmse": _list(total),
                "replay_rmse": _known(study.replay.before),
                "replay_elsewhere": {
                    engine: _known(gap[0])
                    for engine, gap in study.replay.elsewhere.items()
                },
                "floor": _list(floor),
            },
            "after": {
                "torque_nrmse": _list(after),
                "replay_rmse": _known(study.replay.after),
                "replay_elsewhere": {
                    engine: _known(gap[1])
                    for engine, gap in study.replay.elsewhere.items()
                },
            },
        },
        "effects": effects,
        "unexplained": {
            "share": float(
                np.clip(
                    (study.left.after**2).sum() / max((before**2).sum(), 1e-12), 0, 1
                )
            ),
            "above_floor": bool(above.any()),
            "joints": open_joints,
            "times_floor": _list(study.left.ratio),
            "where": [
                _region(r)
                for r in _located(study, study.after.error, rows, open_joints)
            ],
            "predictable": [p.document() for p in told],
        },
        "next_recording": _next(effects, open_joints),
        "where": [_region(r) for r in _before(study, rows, floor)],
        **({"sides": described(study.sides, effects)} if study.sides else {}),
        **context(study),
    }


def _verdict(study: Study, found: bool, faulty: np.ndarray | None, plain: bool) -> str:
    """The verdict; an effect taken back leaves a gap open, if only on the recordings that it was fitted to.

    Args:
        study: what the findings are read from.
        found: whether any effect or fault was.
        faulty: torque NRMSE before a fault of the set-up was put right, where one widened the gap, (n,).
        plain: whether what is left is more than noise that is louder than believed.
    """
    if found and faulty is not None and not study.left.more_than(faulty):
        return "effects_found"
    if found:
        return "unexplained" if study.left.open and plain else "effects_found"
    return "unexplained" if plain or study.rejections else "no_gap"


def _effects(study: Study, rows: Rows) -> list[dict[str, Any]]:
    """Findings on the effects, those with the largest share first."""
    shares = study.predictor.shares()
    log_e = log_e_values(study.selection)
    rates = false_discovery_rates(log_e)
    draws = study.selection.evidence.bootstrap(
        study.selection.fit.terms, np.random.default_rng(0)
    )
    return [
        {
            **_finding(study, applied, rows),
            "parameters": parameters(
                study.selection, applied, draws, _instrumented(study, applied)
            ),
            "share": shares[finding_of(applied)].value,
            "share_interval": [
                shares[finding_of(applied)].low,
                shares[finding_of(applied)].high,
            ],
            "log_e": log_e.get(finding_of(applied)),
            "false_discovery_rate": rates.get(finding_of(applied)),
            "confirmed": None
            if finding_of(applied) not in rates
            else rates[finding_of(applied)] <= FALSE_DISCOVERY_RATE,
        }
        for applied in sorted(
            study.effects, key=lambda e: shares[finding_of(e)].value, reverse=True
        )
    ]


def _instrumented(study: Study, applied: AppliedEffect) -> AppliedEffect | None:
    """An effect found with values by the commands as instruments, where these are known."""
    return next(
        (e for e in study.by_commands if finding_of(e) == finding_of(applied)), None
    )


def _with_faults(
    study: Study,
    effects: list[dict[str, Any]],
    before: np.ndarray,
    after: np.ndarray,
    floor: np.ndarray,
) -> list[dict[str, Any]]:
    """Findings on effects and faults together, those with the largest share first.

    A fault's share is what putting it right takes from the whole gap above the floor; the effects share the rest.
    """
    whole = max(
        float((before - floor).clip(0).sum()), float((before - after).sum()), 1e-9
    )
    repaired = study.before.nrmse
    physical = (
        max(float((repaired - floor).clip(0).sum()), float((repaired - after).sum()))
        / whole
    )
    part = min(physical, 1.0)
    out = [
        {
            **effect,
            "share": effect["share"] * part,
            "share_interval": [x * part for x in effect["share_interval"]],
        }
        for effect in effects
    ]
    for fault in study.faults:
        only, without = (
            before if gap is None else gap
            for gap in (fault.gap_with_only_this, fault.gap_without_this)
        )
        out.append(
            {
                "effect": fault.name,
                "joints": list(fault.joints),
                "probability": fault.probability,
                **fault.document(),
                "share": float(np.clip((before - only).sum() / whole, 0.0, 1.0)),
                "gap_with_only_this": {"torque_nrmse": _list(only)},
                "gap_without_this": {"torque_nrmse": _list(without)},
                "where": [],
                "alternatives": [],
            }
        )
    return sorted(out, key=lambda finding: finding["share"], reverse=True)


def _finding(study: Study, applied: AppliedEffect, rows: Rows) -> dict[str, Any]:
    fit, name = study.selection.fit, finding_of(applied)
    mine = frozenset(t for t in fit.terms if t.finding == name)
    only, without = study.predictor.gap(mine), study.predictor.gap(fit.terms - mine)
    known = _support(study, applied, without.nrmse)
    sure = probability(applied.name, known)
    others = shared(rivals(study.selection, name)[1], sure, known)
    gained = np.sqrt(np.clip(without.error**2 - study.after.error**2, 0.0, None))
    joints = applied.joints or tuple(
        int(j) + 1 for j in np.argsort(-(gained**2).sum(axis=0))[:2]
    )
    return {
        "effect": applied.name,
        "joints": list(applied.joints),
        "probability": sure,
        "set": conformal_set(applied.name, sure, others),
        "support": known.plain(),
        "gap_with_only_this": {
            "torque_nrmse": _list(only.nrmse),
            "replay_rmse": _known(study.replay.only.get(name)),
        },
        "gap_without_this": {
            "torque_nrmse": _list(without.nrmse),
            "replay_rmse": _known(study.replay.without.get(name)),
        },
        "where": [
            _region(r) for r in _regions(study, gained, rows, list(joints), most=1)
        ],
        "alternatives": [
            {
                "effect": r.effect,
                "joints": list(r.joints),
                "probability": r.probability,
                "evidence": r.evidence,
                "separated_by": separated_by(applied.name, r.effect),
            }
            for r in others
            if r.probability > 1e-3
        ],
    }


def _support(study: Study, applied: AppliedEffect, without: np.ndarray) -> Support:
    """What speaks for an effect found, on its joints; of one on the arm or a link those where it closes the gap."""
    closed = without - study.after.nrmse
    places = [j - 1 for j in applied.joints] or list(
        np.flatnonzero(closed >= CLOSING_JOINTS * closed.max())
    )
    left = study.left.after[places] / np.maximum(
        study.left.before[places], ABOVE_FLOOR_NRMSE
    )
    _, others = rivals(study.selection, finding_of(applied))
    return Support(
        margin=float(
            -np.logaddexp.reduce(
                [-700.0, *(TEMPER * min(r.evidence, 0.0) for r in others)]
            )
        ),
        closed=float(closed.max()),
        left=float(left.max()),
        times_floor=float(study.left.ratio[places].max()),
        effects=len(study.effects),
        nominal=float(study.selection.evidence.sigma),
    )


def _regions(
    study: Study, error: np.ndarray, rows: Rows, joints: list[int], most: int = 2
) -> list[Region]:
    return regions(error, rows, study.before.predicted, joints, most)


def _before(study: Study, rows: Rows, floor: np.ndarray) -> list[Region]:
    """Where the gap of the nominal arm lies, on joints where it is above the floor, the widest first."""
    nrmse = study.before.nrmse
    joints = [int(j) + 1 for j in np.argsort(-nrmse) if nrmse[j] > floor[j]]
    return _located(study, study.before.error, rows, joints)


def _located(
    study: Study, error: np.ndarray, rows: Rows, joints: list[int]
) -> list[Region]:
    return located(error, rows, study.before.predicted, study.floor, joints)


def _region(region: Region) -> dict[str, Any]:
    return {
        "joint": region.joint,
        "kind": region.kind,
        "regime": region.regime,
        "share": region.share,
        "coverage": region.coverage,
        "enrichment": region.enrichment,
        **region.detail,
    }


def _next(effects: list[dict[str, Any]], open_joints: list[int]) -> str | None:
    for effect in effects:
        for rival in effect["alternatives"]:
            if rival["probability"] >= OPEN_ALTERNATIVE:
                names = [effect_name(entry["effect"]) for entry in (effect, rival)]
                return f"to tell {names[0]} from {names[1].replace('none', 'nothing')}: {rival['separated_by']}"
    if open_joints:
        joints = ", ".join(map(str, open_joints))
        return (
            f"to place what is unexplained on joint {joints}: "
            "that joint alone, the same path at half and double speed"
        )
    return None


def _list(values: np.ndarray) -> list[float]:
    return [float(v) for v in values]


def _known(values: np.ndarray | None) -> list[float] | None:
    return None if values is None else _list(values)
