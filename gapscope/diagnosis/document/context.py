"""Context of the findings in ``diagnosis.json``: arm, recordings, conditioning, warnings."""

from __future__ import annotations

from typing import Any

import numpy as np

from gapscope.arm.display import effect_name
from gapscope.arm.nominal import NominalArm, arm_entry
from gapscope.arm.recording import Recording
from gapscope.diagnosis.assessment.rejection import Rejection
from gapscope.diagnosis.gap.commanded_torque import WARNING
from gapscope.diagnosis.gap.plausible_motion import short_note, still_note
from gapscope.diagnosis.selection.evidence import Fit
from gapscope.diagnosis.selection.search import Selection
from gapscope.diagnosis.study import Study
from gapscope.model.conditioning import TORQUE_CUTOFF
from gapscope.model.terms import Term


def context(study: Study) -> dict[str, Any]:
    """The arm, the recordings, how they were conditioned, what was noticed, and what was considered."""
    case = study.case
    notes = [
        f"{recording.name}: {note}"
        for recording in (*case.recordings, *case.judged)
        for note in recording.notes
    ]
    inferred = WARNING in case.warnings
    return {
        "arm": arm_entry(case.arm),
        "nominal": {"friction": nominal_friction(case.arm)},
        "presliding": study.selection.presliding_of(study.selection.fit.terms).tolist(),
        "recordings": [
            *(recording_entry(r, "fit") for r in case.recordings),
            *(recording_entry(r, "judge") for r in case.judged),
        ],
        "conditioning": {
            "rate": study.predictor.segments[0].motion.rate,
            "position_cutoff": study.position_cutoff,
            "torque_cutoff": TORQUE_CUTOFF,
            "how": "zero-phase Butterworth, order 4, on both sides; positions cut at twice the frequency where their "
            "spectrum meets its noise; floor from the gap's power density above the band, timing and form of friction",
            "nominal_inertials_std": study.selection.evidence.inertial_error,
            "sampling_skew": study.selection.evidence.skew,
        },
        "judged_on": _judged_on(study, inferred),
        "torque_from": "controller" if inferred else "recorded",
        "warnings": [
            *case.warnings,
            *still_note(case),
            *short_note(case),
            *notes,
            *study.replay_gap.warnings,
        ],
        "considered": [
            *(_rejection_entry(rejection) for rejection in study.rejections),
            *_runners_up(study.selection),
        ],
    }


def nominal_friction(arm: NominalArm) -> dict[str, Any]:
    """The friction that the nominal arm has, and where it comes from."""
    return {
        "source": arm.friction_source or None,
        "coulomb": arm.coulomb.tolist(),
        "viscous": arm.viscous.tolist(),
    }


def recording_entry(recording: Recording, role: str) -> dict[str, Any]:
    """A recording, and whether effects are fitted to it or judged on it."""
    entry = {
        "name": recording.name,
        "duration": recording.duration,
        "rate": recording.rate,
        "role": role,
    }
    if recording.payload is not None:
        entry["payload"] = recording.payload.entry()
    return entry


def _judged_on(study: Study, inferred: bool) -> str:
    """On which data the gaps are measured, in words; ``inferred``: the torque is not recorded but computed."""
    if study.predictor.set_aside:
        text = "recordings set aside for judging"
    elif len(study.case.recordings) > 1:
        text = "each half of a recording, with the values fitted to all else"
    else:
        text = "halves of blocks of the one recording, each with the values fitted to all else"
    if inferred:
        text += "; the torque there is the one that the known controller must have commanded"
    return text


def _rejection_entry(rejection: Rejection) -> dict[str, Any]:
    return {
        "effect": next(iter(rejection.terms)).effect,
        "joints": _joints(rejection.terms),
        "log_evidence": None,
        "gap_closed": -rejection.cost,
        "reason": rejection.reason,
    }


def _runners_up(selection: Selection) -> list[dict[str, Any]]:
    """The best effects that lost a step of the search, and to which effect."""
    out: list[dict[str, Any]] = []
    for winner, loser in selection.considered:
        only_loser, only_winner = loser.terms - winner.terms, winner.terms - loser.terms
        if not only_loser:
            continue
        names = sorted({term.effect for term in only_winner})
        winners = ", ".join(effect_name(name) for name in names)
        closed_more = _nrmse(selection, loser) - _nrmse(selection, winner)
        out.append(
            {
                "effect": next(iter(only_loser)).effect,
                "joints": _joints(only_loser),
                "log_evidence": float(loser.score - winner.score),
                "gap_closed": float(closed_more.sum()),
                "reason": f"{winners} predicts the unseen recordings better",
            }
        )
    return out


def _nrmse(selection: Selection, fit: Fit) -> np.ndarray:
    """Held-out torque NRMSE with the terms of a fit over all folds, (n,)."""
    rows = selection.evidence.rows
    mean_square = (fit.held_out_mse * rows).sum(axis=0) / rows.sum(axis=0)
    return np.asarray(np.sqrt(mean_square) / selection.scale)


def _joints(terms: frozenset[Term]) -> list[int]:
    """Joints of terms on joints; none of those on a link or the arm."""
    return sorted(t.joint for t in terms if t.definition.scope == "joint")
