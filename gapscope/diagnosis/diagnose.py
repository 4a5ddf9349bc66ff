"""The main job: a case goes in, a diagnosis comes out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.diagnosis.assessment.baseline import Baseline
from gapscope.diagnosis.assessment.excess_residual import (
    ExcessResidual,
    elementwise_max,
    excess_residual,
    set_aside,
)
from gapscope.diagnosis.assessment.held_out_prediction import HeldOutPredictor
from gapscope.diagnosis.assessment.instrumental_values import commanded, instrumented
from gapscope.diagnosis.assessment.rejection import Rejection, reject
from gapscope.diagnosis.assessment.replay_gap import ReplayGap, replay_gap
from gapscope.diagnosis.assessment.sensor_sides import Sides, find_sides
from gapscope.diagnosis.document.findings import document
from gapscope.diagnosis.document.plotted_curves import (
    located,
    signatures,
    spectrum,
    traces,
)
from gapscope.diagnosis.gap.commanded_torque import (
    with_commanded_torque,
    with_likelier_rule,
)
from gapscope.diagnosis.gap.torque_gap import (
    TorqueGap,
    noise_floor,
    torque_gap,
    torque_scale,
)
from gapscope.diagnosis.result import Diagnosis
from gapscope.diagnosis.selection.search import Selection, search
from gapscope.diagnosis.setup_faults.detection import find_setup_faults
from gapscope.diagnosis.setup_faults.found_fault import FoundFault, repaired
from gapscope.diagnosis.setup_faults.quantization import find_quantization
from gapscope.diagnosis.thresholds import SINGLE_RECORDING_FOLDS
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.signals.conditioning import (
    TORQUE_CUTOFF,
    Segment,
    blocks,
    condition,
    position_cutoff,
)


@dataclass(frozen=True)
class Study:
    """Everything that the findings of one case are read from.

    Attributes:
        case, body: the case and the dynamics of its nominal arm.
        cutoff: cut-off of the positions [Hz].
        found: result of the search, less what was refused.
        refusals: what was found and taken back.
        effects: the effects found, with values fitted to all that may be fitted.
        judge: predicts unseen data.
        before, after: gap on unseen data without and with the effects.
        floor: RMS that a healthy arm of this kind would leave [N m], (n,).
        left: what is above the floor before and after.
        replay: replay gap without and with the effects.
        faults: what was wrong with the set-up, put right in the case before anything else, and what shows in the
            recordings themselves.
        sides: the gap on either side of the joint torque sensors; ``None`` without sensors.
        by_commands: the effects with values by the commands as instruments; none where commands are not known.
    """

    case: Case
    body: RigidBody
    cutoff: float
    selection: Selection
    rejections: list[Rejection]
    effects: tuple[AppliedEffect, ...]
    predictor: HeldOutPredictor
    before: TorqueGap
    after: TorqueGap
    floor: np.ndarray
    left: ExcessResidual
    replay: ReplayGap
    faults: tuple[FoundFault, ...]
    sides: Sides | None = None
    by_commands: tuple[AppliedEffect, ...] = ()


def diagnose(
    case: Case,
    progress: Callable[[str], None] = lambda message: None,
    baseline: Baseline | None = None,
) -> Diagnosis:
    """Find where the gap of a case lies, which effects cause it, and how far it shrinks with them.

    Args:
        case: the nominal arm and its recordings.
        progress: called with a few words at each step.
        baseline: what the arm was when a reference was recorded, where the case is compared with one.

    Raises:
        GapscopeError: no recording carries a torque that can be trusted, nor is there a known controller with its
            reference that tells it.
        InputError: a recording has no stretch without gaps that is long enough.
    """
    with threadpool_limits(
        1
    ):  # many small matrices: threads would only wait for each other
        return conclude(examine(case, progress, baseline), progress)


def conclude(
    study: Study, progress: Callable[[str], None] = lambda message: None
) -> Diagnosis:
    """The diagnosis of a study."""
    progress("writes the findings")
    content, case = document(study), study.case
    corrected = CorrectedArm(case.arm, study.effects)
    order = [
        finding["effect"] for finding in content["effects"]
    ]  # faults are not part of the arm
    return Diagnosis(
        document=content,
        effects=tuple(
            sorted(study.effects, key=lambda applied: order.index(applied.name))
        ),
        traces=traces(corrected, study.body, study.predictor.segments),
        signatures=signatures(corrected, study.body, study.predictor.segments),
        spectrum=spectrum(
            study.before,
            study.after,
            tuple(s.motion.rate for s in study.predictor.segments),
        ),
        located=located(
            content,
            {"before": study.before, "after": study.after},
            study.floor,
            study.predictor.segments,
        ),
    )


def examine(
    case: Case, progress: Callable[[str], None], baseline: Baseline | None = None
) -> Study:
    """Everything that the findings of a case are read from; see ``diagnose``."""
    case = with_commanded_torque(case)
    _check_torque(case)
    study = _examined(case, progress, baseline)
    likelier = with_likelier_rule(case, study.effects)
    return study if likelier is None else _examined(likelier, progress, baseline)


def _examined(
    case: Case, progress: Callable[[str], None], baseline: Baseline | None
) -> Study:
    """The study of a case that carries a torque."""
    progress("tests the set-up")
    faults = find_setup_faults(case)
    case = repaired(case, faults)
    case = baseline.adjusted(case) if baseline else case
    faults = (*faults, *find_quantization(case))
    for fault in faults:
        progress(f"finds {fault}")
    progress("conditions the signals")
    body = RigidBody(case.arm)
    cutoff = position_cutoff(case.recordings)
    judged = [s for r in case.judged if r.tau is not None for s in condition(r, cutoff)]
    folds = _folds(case, cutoff)
    progress("searches for effects")
    selection = search(case.arm, body, folds, min(TORQUE_CUTOFF, cutoff), progress)
    progress("judges on unseen data")
    selection, rejections = reject(
        HeldOutPredictor(case.arm, body, selection, folds, judged)
    )
    selection = baseline.kept(selection) if baseline else selection
    predictor = HeldOutPredictor(case.arm, body, selection, folds, judged)
    effects = selection.evidence.terms.effects(selection.fit.theta, selection.fit.terms)
    before, after = predictor.gap(frozenset()), predictor.gap(selection.fit.terms)
    floor, nominal = _floor(
        CorrectedArm(case.arm, effects), body, predictor.segments, selection
    )
    least = baseline.floor(after) if baseline else np.zeros_like(floor)
    floor = np.maximum(floor, least)
    left, replayed = excess_residual(selection, after.rmse, least), ReplayGap()
    if judged:
        left = elementwise_max(left, set_aside(selection, before, after, floor))
    if baseline is None:
        progress("replays a recording in the simulator")
        replayed = replay_gap(case, predictor)
    return Study(
        case,
        body,
        cutoff,
        selection,
        rejections,
        effects,
        predictor,
        before,
        after,
        floor,
        left,
        replayed,
        faults,
        find_sides(predictor, nominal),
        _by_commands(case, selection, cutoff),
    )


def _folds(case: Case, cutoff: float) -> list[list[Segment]]:
    """Segments of each recording with a torque; of a single one the segments of its blocks."""
    fitted = [condition(r, cutoff) for r in case.recordings if r.tau is not None]
    return (
        fitted
        if len(fitted) > 1
        else [[b] for s in fitted[0] for b in blocks(s, SINGLE_RECORDING_FOLDS)]
    )


def _by_commands(
    case: Case, selection: Selection, cutoff: float
) -> tuple[AppliedEffect, ...]:
    """The effects found with values by the commands as instruments; none where the commands are not known."""
    told = commanded(case)
    return (
        ()
        if told is None or not selection.fit.terms
        else instrumented(case, selection, _folds(told, cutoff)) or ()
    )


def _check_torque(case: Case) -> None:
    if any(recording.tau is not None for recording in case.recordings):
        return
    noticed = (*case.warnings, *(note for r in case.recordings for note in r.notes))
    why = "; ".join(dict.fromkeys(noticed)) or "none has a torque column"
    raise GapscopeError(
        f"{case.name}: no recording carries a torque that can be trusted ({why})",
        "give torque with its sign in column tau1.., or map it in the case's import: section; positions are enough "
        "where controller: is known and the recordings have its reference in columns q_ref1..",
    )


def _floor(
    corrected: CorrectedArm,
    body: RigidBody,
    segments: list[Segment],
    selection: Selection,
) -> tuple[np.ndarray, np.ndarray]:
    """RMS of a healthy arm [N m], (n,), with its inertials a little wrong; and the part of these inertials."""
    gap = torque_gap(corrected, body, segments)
    floors = np.array([noise_floor(corrected, body, s).floor for s in segments])
    noise2 = np.average(floors**2, axis=0, weights=np.diff(gap.edges))
    evidence, terms = selection.evidence, selection.fit.terms
    plain, allowed = (
        (evidence.held_out_mse(terms, corrected=c) * evidence.rows).sum(axis=0)
        for c in (False, True)
    )
    nominal2 = np.clip(plain - allowed, 0.0, None) / evidence.rows.sum(axis=0)
    nominal2 *= (torque_scale(gap.measured) / selection.scale) ** 2
    return np.asarray(np.sqrt(noise2 + nominal2)), np.asarray(np.sqrt(nominal2))
