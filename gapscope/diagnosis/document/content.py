"""The content of ``diagnosis.json``, put together from a study of a case."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from gapscope.diagnosis.assessment.predictable_share import Predictable, predictable
from gapscope.diagnosis.assessment.sensor_sides import sides_entry
from gapscope.diagnosis.document.context import context
from gapscope.diagnosis.document.entries import (
    known_numbers,
    numbers,
    region_entry,
    states_entry,
)
from gapscope.diagnosis.document.fault_findings import (
    GapStages,
    with_faults,
    with_torques_turned,
)
from gapscope.diagnosis.document.findings import effect_findings, possible_findings
from gapscope.diagnosis.document.slide_units import with_slide_units
from gapscope.diagnosis.document.state_findings import with_states
from gapscope.diagnosis.document.suggested_recording import suggested_recording
from gapscope.diagnosis.document.verdict import verdict
from gapscope.diagnosis.localisation.regimes import located
from gapscope.diagnosis.localisation.stacked_rows import MotionRows, stack
from gapscope.diagnosis.study import Study
from gapscope.diagnosis.thresholds import (
    PREDICTABLE_SHARE,
    SIGNIFICANT_RESIDUAL_RATIO,
)
from gapscope.model.change_findings import change_findings
from gapscope.model.torque_gap import torque_scale


def diagnosis_content(study: Study) -> dict[str, Any]:
    """``diagnosis.json`` of a study, without NaN, as plain Python values."""
    gap = _gap_stages(study)
    rows = stack(study.predictor.segments)
    named = with_torques_turned(effect_findings(study, rows), study.case.arm.n_joints)
    here = with_faults(named, study.faults, gap)
    effects = with_states(here, study.states, study.terms, study.theta)
    possible = possible_findings(study, rows)
    open_joints = [int(j) + 1 for j in np.flatnonzero(study.excess_residual.above)]
    predictions = predictable(study.gap_after, rows, study.floor, open_joints)
    reach = partial(
        verdict,
        explained=_explained(study, gap),
        significant=_significant(study, predictions),
        rejected=bool(study.rejections),
    )
    reached = reach(found=bool(effects or study.changes))
    # where the arm was diagnosed nothing need be missing
    closed = gap.closed if reach(found=bool(here)) == reached else None
    # what stays on a joint is worth a recording only where the verdict says that it is unexplained
    unexplained = open_joints if reached == "unexplained" else []
    content: dict[str, Any] = {
        "schema": 1,
        "case": study.case.name,
        "verdict": reached,
        "gap": _gap_entry(study, gap),
        "effects": effects,
        "possible": possible,
        "changes": change_findings(study.changes),
        **states_entry(study.states.found),
        "closed": closed,
        "unexplained": {
            "share": 0.0 if closed is None else 1.0 - closed,
            "above_floor": bool(unexplained),
            **_unexplained_entry(study, rows, open_joints, predictions),
        },
        "next_recording": suggested_recording(
            effects, possible, unexplained, study.undeclared_coupling
        ),
        "where": _where_before(study, rows, gap),
    }
    if study.sensor_sides is not None:
        content["sides"] = sides_entry(study.sensor_sides, effects)
    return with_slide_units(content | context(study), study.case.arm.sliding)


def _gap_stages(study: Study) -> GapStages:
    repaired = study.gap_before.nrmse
    recorded = [f.gap_before for f in study.faults if f.gap_before is not None]
    return GapStages(
        recorded=recorded[0] if recorded else repaired,
        repaired=repaired,
        corrected=study.gap_after.nrmse,
        floor=study.floor / torque_scale(study.gap_before.measured),
    )


def _explained(study: Study, gap: GapStages) -> bool:
    """Whether the residual is no more than may be left of the gap, with the set-up repaired or as it was given."""
    residual = study.excess_residual
    if not residual.open:
        return True
    # A repaired fault explains all that it took away: the residual is small beside the gap of the case as given.
    widened = any(fault.gap_before is not None for fault in study.faults)
    return widened and not residual.exceeds_explained_share_of(gap.recorded)


def _significant(study: Study, predictions: list[Predictable]) -> bool:
    """Whether the residual of some joint is far above the floor, or can be predicted."""
    ratio = study.excess_residual.ratio
    return any(
        p.share >= PREDICTABLE_SHARE or ratio[p.joint - 1] >= SIGNIFICANT_RESIDUAL_RATIO
        for p in predictions
    )


def _gap_entry(study: Study, gap: GapStages) -> dict[str, Any]:
    replay = study.replay_gap
    elsewhere_before, elsewhere_after = {}, {}
    for engine, (before, after) in replay.elsewhere.items():
        elsewhere_before[engine] = known_numbers(before)
        elsewhere_after[engine] = known_numbers(after)
    return {
        "replayed": replay.by,
        "engine": replay.engine,
        "before": {
            "torque_nrmse": numbers(gap.recorded),
            "replay_rmse": known_numbers(replay.before),
            "replay_elsewhere": elsewhere_before,
            "floor": numbers(gap.floor),
        },
        "after": {
            "torque_nrmse": numbers(gap.corrected),
            "replay_rmse": known_numbers(replay.after),
            "replay_elsewhere": elsewhere_after,
        },
    }


def _unexplained_entry(
    study: Study,
    rows: MotionRows,
    open_joints: list[int],
    predictions: list[Predictable],
) -> dict[str, Any]:
    return {
        "joints": open_joints,
        "times_floor": numbers(study.excess_residual.ratio),
        "where": _where(study, study.gap_after.error, rows, open_joints),
        "predictable": [p.document() for p in predictions],
        "coupling": _coupling_entry(study),
    }


def _coupling_entry(study: Study) -> dict[str, Any] | None:
    """Two joints that seem to be turned by one motor, and the coupling to declare; ``None`` if no two do."""
    found = study.undeclared_coupling
    if found is None:
        return None
    return {
        "joints": [found.joint, found.motor],
        "declare": found.declaration,
        "log_evidence": found.gain,
    }


def _where_before(
    study: Study, rows: MotionRows, gap: GapStages
) -> list[dict[str, Any]]:
    """Where the gap of the nominal arm lies, on joints where it is above the floor, the widest first."""
    nrmse = gap.repaired
    joints = [int(j) + 1 for j in np.argsort(-nrmse) if nrmse[j] > gap.floor[j]]
    return _where(study, study.gap_before.error, rows, joints)


def _where(
    study: Study, error: np.ndarray, rows: MotionRows, joints: list[int]
) -> list[dict[str, Any]]:
    """Regions in which a gap [N m], (M, n), is concentrated."""
    load = study.gap_before.predicted
    places = located(error, rows, load, study.floor, joints)
    return [region_entry(region) for region in places]
