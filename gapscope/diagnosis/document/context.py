"""What a reader of ``diagnosis.json`` wants to know beside the findings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from gapscope.diagnosis.document.wording import effect_name
from gapscope.diagnosis.gap.commanded_torque import WARNING
from gapscope.diagnosis.model.terms import Term
from gapscope.ident.signals.conditioning import TORQUE_CUTOFF

if TYPE_CHECKING:
    from gapscope.diagnosis.diagnose import Study


def context(study: Study) -> dict[str, Any]:
    """The arm, the recordings, how they were conditioned, what was noticed, and what lost."""
    case = study.case
    notes = [
        f"{r.name}: {note}"
        for r in (*case.recordings, *case.judged)
        for note in r.notes
    ]
    roles = [(r, "fit") for r in case.recordings] + [(r, "judge") for r in case.judged]
    if study.predictor.judged:
        judged_on = "recordings set aside for judging"
    elif len(case.recordings) > 1:
        judged_on = "each half of a recording, with the values fitted to all else"
    else:
        judged_on = "halves of blocks of the one recording, each with the values fitted to all else"
    inferred = WARNING in case.warnings
    if inferred:
        judged_on += "; the torque there is the one that the known controller must have commanded"
    return {
        "arm": {"robot": case.arm.name, "joints": list(case.arm.joints)},
        "recordings": [
            {"name": r.name, "duration": r.duration, "rate": r.rate, "role": role}
            | ({} if r.payload is None else {"payload": r.payload.entry()})
            for r, role in roles
        ],
        "conditioning": {
            "rate": study.predictor.segments[0].motion.rate,
            "position_cutoff": study.cutoff,
            "torque_cutoff": TORQUE_CUTOFF,
            "how": "zero-phase Butterworth, order 4, on both sides; positions cut at twice the frequency where their "
            "spectrum meets its noise; floor from the gap's power density above the band, timing and form of friction",
            "nominal_inertials_std": study.selection.evidence.sigma,
            "sampling_skew": study.selection.evidence.skew,
        },
        "judged_on": judged_on,
        "torque_from": "controller" if inferred else "recorded",
        "warnings": [*case.warnings, *notes, *study.replay.warnings],
        "considered": _considered(study),
    }


def _considered(study: Study) -> list[dict[str, Any]]:
    """What was found and taken back, then the best rivals at each step of the search; and why they lost."""
    scale = study.selection.scale
    evidence = study.selection.evidence
    out: list[dict[str, Any]] = [
        {
            "effect": next(iter(refusal.terms)).effect,
            "joints": _joints(refusal.terms),
            "log_evidence": None,
            "gap_closed": -refusal.cost,
            "reason": refusal.reason,
        }
        for refusal in study.rejections
    ]
    for winner, loser in study.selection.considered:
        terms = loser.terms - winner.terms
        if not terms:
            continue
        name = next(iter(terms)).effect
        gap = [
            np.sqrt(
                (f.held_out_mse * evidence.rows).sum(axis=0) / evidence.rows.sum(axis=0)
            )
            / scale
            for f in (winner, loser)
        ]
        lost = {t.effect for t in winner.terms - loser.terms}
        out.append(
            {
                "effect": name,
                "joints": _joints(terms),
                "log_evidence": float(loser.score - winner.score),
                "gap_closed": float((gap[1] - gap[0]).sum()),
                "reason": f"{', '.join(effect_name(e) for e in sorted(lost))} predicts the unseen recordings better",
            }
        )
    return out


def _joints(terms: frozenset[Term]) -> list[int]:
    """Joints of terms on joints; none of those on a link or the arm."""
    return sorted(t.joint for t in terms if t.definition.scope == "joint")
