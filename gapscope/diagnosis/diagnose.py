"""The diagnosis of a case: conditioning, set-up, search, held-out gaps, findings."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.diagnosis.document.diagnosis_json import diagnosis_content
from gapscope.diagnosis.document.plotted_curves import (
    located,
    signatures,
    spectrum,
    traces,
)
from gapscope.diagnosis.result import Diagnosis
from gapscope.diagnosis.study import Progress, Study, examine
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm


def diagnose(case: Case, progress: Progress = lambda message: None) -> Diagnosis:
    """Find where the gap of a case lies, which effects cause it, and how far it shrinks with them.

    Args:
        case: the nominal arm and its recordings.
        progress: called with a few words at each step.

    Raises:
        GapscopeError: no recording carries a torque that can be trusted, nor is there a known controller with its
            reference that determines it.
        InputError: a recording has no stretch without gaps that is long enough.
    """
    # Many small matrices: threads would only wait for each other.
    with threadpool_limits(1):
        study = examine(case, progress)
        return build_diagnosis(study, progress)


def build_diagnosis(
    study: Study, progress: Progress = lambda message: None
) -> Diagnosis:
    """The diagnosis of a study: its findings, and the curves that a report draws."""
    progress("writes the findings")
    content = diagnosis_content(study)
    segments = study.predictor.segments
    presliding = study.selection.presliding_of(study.selection.fit.terms)
    arm = replace(study.case.arm, presliding=presliding)
    corrected = CorrectedArm(arm, study.effects)
    rates = tuple(segment.motion.rate for segment in segments)
    gaps = {"before": study.gap_before, "after": study.gap_after}
    return Diagnosis(
        document=content,
        effects=_in_order(study.effects, content["effects"]),
        traces=traces(CorrectedArm(study.case.arm), corrected, study.body, segments),
        signatures=signatures(corrected, study.body, segments),
        spectrum=spectrum(study.gap_before, study.gap_after, rates),
        located=located(content, gaps, study.floor, segments),
        possible=_in_order(study.possible, content["possible"]),
        presliding=tuple(presliding.tolist()),
        faults=study.faults,
        arm=study.case.arm,
        replayed=study.replay_gap.motion,
        states=study.states.effects(study.terms, study.theta),
        case_file=study.case.file,
    )


def _in_order(
    effects: tuple[AppliedEffect, ...], findings: list[dict[str, Any]]
) -> tuple[AppliedEffect, ...]:
    """Effects in the order of the findings."""
    # Set-up faults are among the findings, too, but are no part of the corrected arm.
    order = [finding["effect"] for finding in findings]
    return tuple(sorted(effects, key=lambda effect: order.index(effect.name)))
