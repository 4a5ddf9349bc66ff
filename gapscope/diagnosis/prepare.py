"""A case made ready: a torque, its set-up put right, recordings that share a state."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

from gapscope.arm.case import Case
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.agreement import Agreement, alike, compared
from gapscope.diagnosis.gap.commanded_torque import (
    WARNING,
    with_commanded_torque,
    with_likelier_rule,
)
from gapscope.diagnosis.gap.plausible_data import (
    check_moving,
    check_stamps,
    check_torque,
    select_windows,
    up_to_changes,
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
from gapscope.diagnosis.told_controller import (
    ToldController,
    with_fed_forward,
    with_told_controller,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.effect import External
from gapscope.effects.setup_faults import TimeStamps
from gapscope.model.changes import Change, changes_of
from gapscope.model.conditioning import (
    position_cutoff,
)
from gapscope.model.difference import Difference
from gapscope.model.rows import comparable

Progress = Callable[[str], None]
"""Called with a few words at each step."""


def silent(message: str) -> None:
    """Progress that nobody sees."""


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
        doubted: whether no ordinary errors of the nominal arm make its torque: it is another one, unless
            effects explain that.
        inherent: name and variant of set-up faults that are no news: they are repaired and not reported.
        another_arm: whether they are of another arm: nothing can be found of it then.
        told: the controller, if its references told it for want of a torque.
    """

    case: Case
    position_cutoff: float
    faults: tuple[FoundFault, ...]
    changes: tuple[Change, ...]
    states: States
    given: Case
    references: tuple[FoundFault, ...]
    setup_faults: tuple[FoundFault, ...]
    doubted: bool
    inherent: Collection[tuple[str, str]] = ()
    another_arm: bool = False
    told: ToldController | None = None

    def by_likelier_rule(
        self,
        effects: tuple[AppliedEffect, ...],
        progress: Progress,
    ) -> Prepared | None:
        """The case once more if another rule of the controller explains its computed torque better than effects."""
        case = with_likelier_rule(self.given, effects)
        if case is None:
            return None
        return _repaired(case, progress, self.references, self.inherent)

    def of_another_arm(self) -> Prepared:
        """The same as of another arm than the nominal one."""
        # time stamps show without an arm; all else was found against the wrong one
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

    def as_given(self, progress: Progress) -> Prepared | None:
        """The case once more without repair of the faults that are news; ``None`` if there is none to leave out."""
        # stamps are wrong by themselves, and what the reference has is no news
        kept = tuple(
            f
            for f in self.setup_faults
            if f.name == TimeStamps.name or (f.name, f.variant) in self.inherent
        )
        if len(kept) == len(self.setup_faults):
            return None
        return _repaired(self.given, progress, self.references, self.inherent, kept)


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
    case, references, told = with_torque(case, declared)
    return replace(_repaired(case, progress, references, inherent), told=told)


def with_torque(
    case: Case, declared: NominalArm | None = None
) -> tuple[Case, tuple[FoundFault, ...], ToldController | None]:
    """The case with a torque that can be trusted, faults of references put right, and a controller that they told.

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
    looked = replace(select_windows(even), arm=declared or even.arm)
    right = with_fed_forward(case, looked) if with_references else case
    if right is not case:
        return with_torque(right, declared)
    seen, references = find_reference_faults(looked)
    case = replace(repaired(case, references), warnings=seen.warnings)
    told = None
    # beside a reference gains would take up what has changed
    if declared is None:
        check_moving(case)
        case, told = with_told_controller(case)
    case = with_commanded_torque(case)
    check_torque(case)
    check_moving(case)
    return case, references, told


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
    kept, doubted = as_nominal_arm(case, setup_faults)
    # what an arm seems to have that is another one may be what it has: the search tells
    setup_faults = setup_faults if doubted else kept
    case = repaired(case, setup_faults)
    # A wrong unit scales the step of an encoder: quantisation is measured after the repair.
    every = (*references, *setup_faults, *find_quantization(select_windows(case)))
    # wrong on the reference, stamps are no news, in whatever way they are wrong
    stamped = any(name == TimeStamps.name for name, _ in inherent)
    faults = tuple(
        f
        for f in every
        if (f.name, f.variant) not in inherent
        and not (stamped and f.name == TimeStamps.name)
    )
    for fault in faults:
        progress(f"finds {fault}")
    # of the recordings as a whole, before they are cut and left out
    cutoff = position_cutoff(case.recordings)
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
        doubted=doubted,
        inherent=inherent,
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
    changes = _without_common_push((*changes, *apart), len(case.recordings))
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


def _without_common_push(
    changes: tuple[Change, ...], recordings: int
) -> tuple[Change, ...]:
    """Changes but a force that comes and goes, by their intervals, at the same times wherever it does.

    If some recordings have it, or the only one, it is an effect of all of them, which the search finds.
    """
    pushes = [c for c in changes if isinstance(c.term.definition, External)]
    # in the order of recordings and moments: one push of each recording is a pair
    begins, ends = pushes[::2], pushes[1::2]
    names = [c.recording for c in begins]
    once = names == [c.recording for c in ends] and len(set(names)) == len(names)
    alike = all(
        max(c.interval[0] for c in some) <= min(c.interval[1] for c in some)
        for some in (begins, ends)
        if some
    )
    if not (once and alike and len(names) >= min(2, recordings)):
        return changes
    return tuple(c for c in changes if not isinstance(c.term.definition, External))


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
