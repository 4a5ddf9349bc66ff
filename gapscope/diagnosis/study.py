"""A case examined: what was searched, found, rejected and measured, from which the findings are written."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import rms
from gapscope.diagnosis.agreement import Agreement, alike, compared
from gapscope.diagnosis.assessment.confidence import Confidence, divide
from gapscope.diagnosis.assessment.held_out_prediction import (
    ExcessResidual,
    HeldOutPredictor,
    Rejection,
    measured_gap,
    reject,
)
from gapscope.diagnosis.assessment.instrumental_values import commanded, instrumented
from gapscope.diagnosis.assessment.replay_gap import ReplayGap, replay_gap
from gapscope.diagnosis.assessment.sensor_sides import SensorSides, find_sides
from gapscope.diagnosis.gap.commanded_torque import (
    WARNING,
    with_commanded_torque,
    with_likelier_rule,
)
from gapscope.diagnosis.gap.plausible_data import (
    check_moving,
    check_stamps,
    check_torque,
    folds_of,
    select_windows,
    up_to_changes,
)
from gapscope.diagnosis.selection.fitted_model import Selection
from gapscope.diagnosis.selection.search import search, without_search
from gapscope.diagnosis.selection.undeclared_coupling import (
    UndeclaredCoupling,
    undeclared_coupling,
)
from gapscope.diagnosis.setup_faults.clocks import find_quantization
from gapscope.diagnosis.setup_faults.detection import (
    as_nominal_arm,
    find_setup_faults,
    on_one_clock,
    only_of_time,
    upright,
)
from gapscope.diagnosis.setup_faults.found_fault import FoundFault, repaired
from gapscope.diagnosis.setup_faults.references import find_reference_faults
from gapscope.diagnosis.states import States, states_of
from gapscope.diagnosis.thresholds import NO_TORQUE
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.setup_faults import TimeStamps
from gapscope.model.changes import Change, changes_of
from gapscope.model.conditioning import (
    TORQUE_CUTOFF,
    Segment,
    condition,
    position_cutoff,
)
from gapscope.model.difference import Difference
from gapscope.model.rows import comparable
from gapscope.model.terms import Term, Terms
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
        another_arm: whether the recordings are of another arm than the nominal one; no effect was looked for then.
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
        states: the states of all recordings; the arm was diagnosed in the first.
        sensor_sides: the gap on either side of the joint torque sensors; ``None`` without sensors.
        undeclared_coupling: two joints that seem to be turned by one motor of which the case says nothing, or ``None``.
        instrumented_effects: all effects found with values by the commands as instruments; empty if not known.
    """

    case: Case
    body: RigidBody
    position_cutoff: float
    another_arm: bool
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
    changes: tuple[Change, ...]
    states: States
    sensor_sides: SensorSides | None
    undeclared_coupling: UndeclaredCoupling | None
    instrumented_effects: tuple[AppliedEffect, ...]

    @property
    def terms(self) -> Terms:
        """All terms, with the nonlinear parameters of those that have some."""
        return self.selection.evidence.terms

    @property
    def theta(self) -> np.ndarray:
        """Coordinates of the effects that are named, (P,)."""
        theta = np.zeros(self.terms.size)
        for term in self.selection.fit.terms:
            places = list(term.columns)
            theta[places] = self.selection.fit.theta[places]
        return theta


@dataclass(frozen=True)
class Prepared:
    """A case that can be fitted.

    Attributes:
        case: with a torque in its recordings, the set-up faults put right, recordings cut where they change, and the
            windows that are looked at of long ones.
        position_cutoff: cut-off of the positions [Hz].
        faults: set-up faults, which are repaired in ``case``, and what shows in the recordings themselves.
        changes: what changed during a recording.
        states: of all recordings; ``case`` has those that share the first.
        given: the case with a torque, nothing but its references put right.
        references: faults of its references.
        setup_faults: those that were found beside these and put right.
        another_arm: whether the recordings are of another arm than the nominal one: nothing can be found of it then.
    """

    case: Case
    position_cutoff: float
    faults: tuple[FoundFault, ...]
    changes: tuple[Change, ...]
    states: States
    given: Case
    references: tuple[FoundFault, ...]
    setup_faults: tuple[FoundFault, ...]
    another_arm: bool

    def by_likelier_rule(
        self,
        effects: tuple[AppliedEffect, ...],
        progress: Progress,
        inherent: Collection[tuple[str, str]] = (),
    ) -> Prepared | None:
        """The case once more if another rule of the controller explains its computed torque better than effects."""
        case = with_likelier_rule(self.given, effects)
        if case is None:
            return None
        return _repaired(case, progress, self.references, inherent)

    def of_another_arm(self) -> Prepared:
        """The same as of another arm than the nominal one."""
        of_time = only_of_time(self.setup_faults)
        kept = (f for f in self.faults if f in of_time or f not in self.setup_faults)
        return replace(
            self,
            case=select_windows(repaired(self.given, of_time)),
            faults=tuple(kept),
            changes=(),
            states=States(None),
            setup_faults=of_time,
            another_arm=True,
        )

    def as_given(
        self, progress: Progress, inherent: Collection[tuple[str, str]]
    ) -> Prepared | None:
        """The case once more without repair of the faults that are news; ``None`` if there is none to leave out."""
        kept = tuple(
            f
            for f in self.setup_faults
            if f.name == TimeStamps.name or (f.name, f.variant) in inherent
        )
        if len(kept) == len(self.setup_faults):
            return None
        return _repaired(self.given, progress, self.references, inherent, kept)


def prepare(
    case: Case,
    progress: Progress,
    declared: NominalArm | None = None,
    inherent: Collection[tuple[str, str]] = (),
) -> Prepared:
    """Put the set-up of a case right, and cut its recordings where something changes.

    Args:
        case: the nominal arm and its recordings.
        progress: called with a few words at each step.
        declared: the arm of which the case's controller knows, if that is not the nominal one.
        inherent: name and variant of set-up faults that are no news: they are repaired and not reported.

    Raises:
        GapscopeError: no recording carries a torque that can be trusted, nor is there a known controller with its
            reference that determines it.
        InputError: a recording holds what no arm can have.
    """
    case, references = with_torque(case, declared)
    return _repaired(case, progress, references, inherent)


def with_torque(
    case: Case, declared: NominalArm | None = None
) -> tuple[Case, tuple[FoundFault, ...]]:
    """The case with faults of references put right and a torque that can be trusted, and these faults.

    Args:
        case: the nominal arm and its recordings.
        declared: the arm of which the case's controller knows, if that is not the nominal one.

    Raises:
        GapscopeError: no recording carries a torque that can be trusted, nor is there a known controller with its
            reference that determines it.
        InputError: a recording holds what no arm can have.
    """
    check_stamps(case)
    # A torque is worked out of references and gains: these are put right first, on one clock; its own repair comes
    # with that of the other faults.
    with_references = any(r.q_ref is not None for r in case.recordings)
    even = on_one_clock(case) if with_references else case
    # what a controller feeds forward is the torque of the arm that is declared, not of one identified since
    seen, references = find_reference_faults(
        replace(select_windows(even), arm=declared or even.arm)
    )
    case = replace(repaired(case, references), warnings=seen.warnings)
    case = with_commanded_torque(case)
    check_torque(case)
    check_moving(case)
    return case, references


def _repaired(
    case: Case,
    progress: Progress,
    references: tuple[FoundFault, ...],
    inherent: Collection[tuple[str, str]] = (),
    setup_faults: tuple[FoundFault, ...] | None = None,
) -> Prepared:
    """A case that carries a torque, with its faults of references put right already, and others that may be known."""
    given = case
    if setup_faults is None:
        progress("tests the set-up")
        setup_faults = find_setup_faults(case)
    setup_faults, another = as_nominal_arm(case, setup_faults)
    case = repaired(case, setup_faults)
    # A wrong unit scales the step of an encoder: quantisation is measured after the repair.
    every = (*references, *setup_faults, *find_quantization(select_windows(case)))
    stamped = any(name == TimeStamps.name for name, _ in inherent)
    faults = tuple(
        f
        for f in every
        if (f.name, f.variant) not in inherent
        and not (stamped and f.name == TimeStamps.name)
    )
    for fault in faults:
        progress(f"finds {fault}")
    cutoff = position_cutoff(case.recordings)
    changes: tuple[Change, ...] = ()
    states = States(None)
    if another:
        case = select_windows(case)
    else:
        case, changes, states = _in_one_state(case, progress)
    return Prepared(
        case=case,
        position_cutoff=cutoff,
        faults=faults,
        changes=changes,
        states=states,
        given=given,
        references=references,
        setup_faults=setup_faults,
        another_arm=another,
    )


def _in_one_state(
    case: Case, progress: Progress
) -> tuple[Case, tuple[Change, ...], States]:
    """The case cut where something changes, with those recordings that share a state; what changes, and all states."""
    progress("asks what changes during recordings and between them")
    # about an arm that hangs otherwise everything seems to change
    looked = upright(select_windows(case))
    changes, between = changes_of(looked.recordings, looked.arm, progress)
    # what is judged on changes no value: it is asked by itself
    apart, _ = changes_of(looked.judged, looked.arm, progress)
    changes += apart
    for change in changes:
        progress(f"finds {change}")
    whole = *case.recordings, *case.judged
    case = select_windows(up_to_changes(case, changes))
    as_mounted = replace(case, arm=looked.arm)
    agreement = _agreement(as_mounted, changes, between, progress)
    states = states_of(case, whole, agreement, changes)
    if states.others:
        progress("diagnoses the recordings that share a state")
        case = states.first(case)
    return case, changes, states


def _agreement(
    case: Case,
    changes: Sequence[Change],
    between: Difference | None,
    progress: Progress,
) -> Agreement | None:
    """Whether the recordings of a case share a state, if there are two; compared where one may differ."""
    recordings = comparable(case.recordings)
    # what an integrator held at the start of each recording is not known of a torque that was worked out
    if len(recordings) < 2 or WARNING in case.warnings:
        return None
    if between is None:
        return alike(case, recordings)
    # beside what changes during them, they were compared as they are
    return compared(case, recordings, progress, None if changes else between)


def examine(case: Case, progress: Progress) -> Study:
    """Search a case for effects and measure what they close.

    Args:
        case: the nominal arm and its recordings.
        progress: called with a few words at each step.

    Raises:
        GapscopeError: no recording carries a torque that can be trusted, nor is there a known controller with its
            reference that determines it.
        InputError: a recording has no stretch without gaps that is long enough, or holds what no arm can have.
    """
    prepared = prepare(case, progress)
    study = _study(prepared, progress)
    likelier = prepared.by_likelier_rule(study.effects, progress)
    if likelier is not None:
        prepared, study = likelier, _study(likelier, progress)
    if not study.another_arm and rms(study.gap_after.nrmse, None) > NO_TORQUE:
        # with all that was found it still predicts worse than no torque at all
        return _study(prepared.of_another_arm(), progress)
    return study


def _study(prepared: Prepared, progress: Progress) -> Study:
    """The study of a case that can be fitted."""
    case = prepared.case
    found, rejections = _select(prepared, progress)
    measured = measured_gap(found)
    naming = divide(found, measured.residual)
    selection, predictor = naming.selection, found.of(naming.selection)
    terms = found.selection.fit.terms
    possible = frozenset(t for t in terms if t.finding in naming.possible)
    if naming.possible:
        measured = measured_gap(predictor)

    above = np.flatnonzero(measured.residual.above) + 1
    progress("replays a recording in the simulator")
    replay = replay_gap(case, predictor)
    return Study(
        case=case,
        body=predictor.body,
        position_cutoff=prepared.position_cutoff,
        another_arm=prepared.another_arm,
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
        faults=prepared.faults,
        changes=prepared.changes,
        states=prepared.states,
        sensor_sides=find_sides(predictor, np.sqrt(measured.inertial_mse)),
        undeclared_coupling=undeclared_coupling(found.selection, above.tolist()),
        instrumented_effects=_instrumented_effects(case, found.selection),
    )


def _effects(selection: Selection, terms: frozenset[Term]) -> tuple[AppliedEffect, ...]:
    """Some of a selection's terms as effects with values."""
    return selection.evidence.terms.effects(selection.fit.theta, terms)


def _select(
    prepared: Prepared, progress: Progress
) -> tuple[HeldOutPredictor, list[Rejection]]:
    """Search for effects and reject those that held-out data does not bear out; another arm has none."""
    case = prepared.case
    body = RigidBody(case.arm)
    set_aside = [
        segment
        for recording in case.judged
        if recording.tau is not None
        for segment in condition(recording)
    ]
    folds = _folds(case)
    cutoff = min(TORQUE_CUTOFF, prepared.position_cutoff)
    if prepared.another_arm:
        found = without_search(case.arm, folds, cutoff)
    else:
        progress("searches for effects")
        found = search(case.arm, _with_torque(case), folds, cutoff, progress)
    progress("predicts held-out data")
    predictor = HeldOutPredictor(case.arm, body, found, folds, set_aside)
    selection, rejections = reject(predictor)
    return predictor.of(selection), rejections


def _folds(case: Case) -> list[list[Segment]]:
    """Folds of the segments of all recordings with a torque."""
    return folds_of([condition(recording) for recording in _with_torque(case)])


def _with_torque(case: Case) -> list[Recording]:
    return [r for r in case.recordings if r.tau is not None]


def _instrumented_effects(
    case: Case, selection: Selection
) -> tuple[AppliedEffect, ...]:
    """The effects found with values by the commands as instruments; empty if the commands are not known."""
    commanded_case = commanded(case)
    if commanded_case is None or not selection.fit.terms:
        return ()
    return instrumented(case, selection, _folds(commanded_case)) or ()
