"""A case examined: what was searched, found, rejected and measured, from which the findings are written."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.diagnosis.assessment.baseline import Baseline
from gapscope.diagnosis.assessment.confidence import Confidence
from gapscope.diagnosis.assessment.excess_residual import ExcessResidual
from gapscope.diagnosis.assessment.held_out_prediction import HeldOutPredictor
from gapscope.diagnosis.assessment.instrumental_values import commanded, instrumented
from gapscope.diagnosis.assessment.measured_gap import measured_gap
from gapscope.diagnosis.assessment.naming import divide
from gapscope.diagnosis.assessment.rejection import Rejection, reject
from gapscope.diagnosis.assessment.replay_gap import ReplayGap, replay_gap
from gapscope.diagnosis.assessment.sensor_sides import SensorSides, find_sides
from gapscope.diagnosis.gap.changes_during import changes_during, up_to_changes
from gapscope.diagnosis.gap.commanded_torque import (
    with_commanded_torque,
    with_likelier_rule,
)
from gapscope.diagnosis.gap.excerpt import excerpt, folds_of
from gapscope.diagnosis.gap.plausible_data import check_stamps, check_torque
from gapscope.diagnosis.gap.plausible_motion import check_moving
from gapscope.diagnosis.selection.search import Selection, search
from gapscope.diagnosis.selection.undeclared_coupling import (
    UndeclaredCoupling,
    undeclared_coupling,
)
from gapscope.diagnosis.setup_faults.detection import find_setup_faults, on_one_clock
from gapscope.diagnosis.setup_faults.found_fault import FoundFault, repaired
from gapscope.diagnosis.setup_faults.quantization import find_quantization
from gapscope.diagnosis.setup_faults.references.detection import find_reference_faults
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.kalman.changes import RecordingChange
from gapscope.ident.signals.conditioning import (
    TORQUE_CUTOFF,
    Segment,
    condition,
    position_cutoff,
)
from gapscope.model.terms import Term
from gapscope.model.torque_gap import TorqueGap

Progress = Callable[[str], None]
"""Called with a few words at each step."""


@dataclass(frozen=True)
class Study:
    """Everything from which the findings on one case are written; n joints.

    Attributes:
        case: the case, with the set-up faults repaired, a torque in its recordings, these cut where they change, and
            of long ones the windows that are looked at.
        body: dynamics of its nominal arm.
        position_cutoff: cut-off of the positions [Hz].
        selection: result of the search, less what was rejected and what is possible only.
        rejections: terms that the search found and held-out data does not bear out.
        effects: the effects named, with values fitted to all recordings that may be fitted.
        predictor: predicts held-out data with what is named.
        found: the same with what is possible as well.
        possible: the effects that are possible only, with values beside all others.
        confidences: how sure each finding is, named or possible, by its name.
        gap_before, gap_after: gap on held-out data of the nominal arm, and with the effects named.
        floor: RMS that a healthy arm of this kind would leave [N m], (n,).
        excess_residual: what exceeds the floor, before and after.
        replay_gap: replay gap, before and after.
        faults: set-up faults, which are repaired in ``case``, and what shows in the recordings themselves.
        changes: what changed during a recording.
        sensor_sides: the gap on either side of the joint torque sensors; ``None`` without sensors.
        undeclared_coupling: two joints that seem to be turned by one motor of which the case says nothing, or ``None``.
        instrumented_effects: all effects found with values by the commands as instruments; empty if not known.
    """

    case: Case
    body: RigidBody
    position_cutoff: float
    selection: Selection
    rejections: list[Rejection]
    effects: tuple[AppliedEffect, ...]
    predictor: HeldOutPredictor
    found: HeldOutPredictor
    possible: tuple[AppliedEffect, ...]
    confidences: Mapping[str, Confidence]
    gap_before: TorqueGap
    gap_after: TorqueGap
    floor: np.ndarray
    excess_residual: ExcessResidual
    replay_gap: ReplayGap
    faults: tuple[FoundFault, ...]
    changes: tuple[RecordingChange, ...]
    sensor_sides: SensorSides | None
    undeclared_coupling: UndeclaredCoupling | None
    instrumented_effects: tuple[AppliedEffect, ...]


def examine(case: Case, progress: Progress, baseline: Baseline | None = None) -> Study:
    """Search a case for effects and measure what they close.

    Args:
        case: the nominal arm and its recordings.
        progress: called with a few words at each step.
        baseline: what the arm was when a reference was recorded, if the case is compared with one.

    Raises:
        GapscopeError: no recording carries a torque that can be trusted, nor is there a known controller with its
            reference that determines it.
        InputError: a recording has no stretch without gaps that is long enough, or holds what no arm can have.
    """
    check_stamps(case)
    # A torque is worked out of references and gains: these are put right first, on one clock; its own repair comes
    # with that of the other faults.
    with_references = any(r.q_ref is not None for r in case.recordings)
    even = on_one_clock(case) if with_references else case
    # what a controller feeds forward is the torque of the arm that is declared, not of one identified since
    declared = even.arm if baseline is None else baseline.declared or even.arm
    seen, references = find_reference_faults(replace(excerpt(even), arm=declared))
    case = replace(repaired(case, references), warnings=seen.warnings)
    case = with_commanded_torque(case)
    check_torque(case)
    check_moving(case)
    study = _examine(case, progress, baseline, references)
    # A torque computed by the controller's rule may be explained better by another rule: then once more by that one.
    likelier_case = with_likelier_rule(case, study.effects)
    if likelier_case is None:
        return study
    return _examine(likelier_case, progress, baseline, references)


def _examine(
    case: Case,
    progress: Progress,
    baseline: Baseline | None,
    references: tuple[FoundFault, ...],
) -> Study:
    """The study of a case that carries a torque, with its faults of references, put right already."""
    case, faults = _repair(case, progress, baseline, references)
    progress("conditions the signals")
    cutoff = position_cutoff(case.recordings)
    progress("looks for changes during recordings")
    changes = changes_during(excerpt(case), cutoff)
    for change in changes:
        progress(f"finds {change}")
    case = excerpt(up_to_changes(case, changes))
    found, rejections = _select(case, cutoff, progress, baseline)
    measured = measured_gap(found, baseline)
    naming = divide(found, measured.residual)
    selection, predictor = naming.selection, found.of(naming.selection)
    terms = found.selection.fit.terms
    possible = frozenset(t for t in terms if t.finding in naming.possible)
    if naming.possible:
        measured = measured_gap(predictor, baseline)

    above = np.flatnonzero(measured.residual.above) + 1
    replay = ReplayGap()
    # Against a reference, the effects act on the arm identified there: they close nothing of the nominal arm's replay.
    if baseline is None:
        progress("replays a recording in the simulator")
        replay = replay_gap(case, predictor)
    return Study(
        case=case,
        body=predictor.body,
        position_cutoff=cutoff,
        selection=selection,
        rejections=rejections,
        effects=_effects(selection, selection.fit.terms),
        predictor=predictor,
        found=found,
        possible=_effects(found.selection, possible),
        confidences={**naming.named, **naming.possible},
        gap_before=predictor.gap(frozenset()),
        gap_after=measured.gap_after,
        floor=measured.floor,
        excess_residual=measured.residual,
        replay_gap=replay,
        faults=faults,
        changes=changes,
        sensor_sides=find_sides(predictor, np.sqrt(measured.inertial_mse)),
        undeclared_coupling=undeclared_coupling(found.selection, above.tolist()),
        instrumented_effects=_instrumented_effects(case, found.selection, cutoff),
    )


def _effects(selection: Selection, terms: frozenset[Term]) -> tuple[AppliedEffect, ...]:
    """Some of a selection's terms as effects with values."""
    return selection.evidence.terms.effects(selection.fit.theta, terms)


def _repair(
    case: Case,
    progress: Progress,
    baseline: Baseline | None,
    references: tuple[FoundFault, ...],
) -> tuple[Case, tuple[FoundFault, ...]]:
    """The case with its set-up faults repaired and the baseline taken out, and all faults found."""
    progress("tests the set-up")
    setup_faults = find_setup_faults(case)
    case = repaired(case, setup_faults)
    if baseline is not None:
        case = baseline.adjusted(excerpt(case))
    # A wrong unit scales the step of an encoder: quantisation is measured after the repair.
    faults = (*references, *setup_faults, *find_quantization(excerpt(case)))
    if baseline is not None:
        faults = tuple(f for f in faults if (f.name, f.variant) not in baseline.faults)
    for fault in faults:
        progress(f"finds {fault}")
    return case, faults


def _select(
    case: Case, cutoff: float, progress: Progress, baseline: Baseline | None
) -> tuple[HeldOutPredictor, list[Rejection]]:
    """Search for effects and reject those that held-out data does not bear out."""
    body = RigidBody(case.arm)
    set_aside = [
        segment
        for recording in case.judged
        if recording.tau is not None
        for segment in condition(recording, cutoff)
    ]
    folds = _folds(case, cutoff)
    progress("searches for effects")
    errors = baseline.errors if baseline else None
    # of a reference itself only what a healthy arm has counts, neither compliance nor pairs
    is_reference = baseline is not None and errors is None
    band = min(TORQUE_CUTOFF, cutoff)
    found = search(case.arm, body, folds, band, progress, errors, quick=is_reference)
    progress("predicts held-out data")
    predictor = HeldOutPredictor(case.arm, body, found, folds, set_aside)
    selection, rejections = reject(predictor)
    return predictor.of(selection), rejections


def _folds(case: Case, cutoff: float) -> list[list[Segment]]:
    """Folds of the segments of all recordings with a torque."""
    recordings = [r for r in case.recordings if r.tau is not None]
    return folds_of([condition(recording, cutoff) for recording in recordings])


def _instrumented_effects(
    case: Case, selection: Selection, cutoff: float
) -> tuple[AppliedEffect, ...]:
    """The effects found with values by the commands as instruments; empty if the commands are not known."""
    commanded_case = commanded(case)
    if commanded_case is None or not selection.fit.terms:
        return ()
    return instrumented(case, selection, _folds(commanded_case, cutoff)) or ()
