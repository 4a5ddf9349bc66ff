"""What changed: the contrast of a case and a reference of the same arm; ``docs/contrast.md`` derives it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.diagnosis.gap.commanded_torque import with_commanded_torque
from gapscope.diagnosis.reference.change import CASE, Change, Comparison
from gapscope.diagnosis.reference.comparison_document import diagnosis_of
from gapscope.diagnosis.reference.kept_reference import URDF, KeptReference
from gapscope.diagnosis.reference.same_arm import (
    check_same_joints,
    check_same_places,
    place_of,
)
from gapscope.diagnosis.study import Prepared, prepare
from gapscope.diagnosis.thresholds import FRICTION_DAY_TO_DAY
from gapscope.model.design import fitted_arm
from gapscope.model.difference import Search
from gapscope.model.rows import Rows


def diagnose_change(
    case: Case,
    reference: KeptReference,
    folder: Path,
    progress: Callable[[str], None] = lambda message: None,
) -> Change:
    """Find what a case has that a reference does not have.

    Args:
        case: the case.
        reference: the same arm, when it was known to be healthy and without load.
        folder: where the URDF of the identified arm is written, ``identified.urdf``.
        progress: called with a few words at each step.

    Raises:
        InputError: the reference is another robot, or in another mounting.
        GapscopeError: the case cannot be diagnosed.
    """
    check_same_joints(case, reference)
    nominal = reference.on(with_commanded_torque(case), folder)
    check_same_places(case, nominal.arm, place_of(reference))
    with threadpool_limits(1):
        prepared = prepare(nominal, progress, case.arm, reference.faults)
        comparison = _compared(prepared, case, reference, progress)
        given = prepared.as_given(progress, reference.faults)
        # a fault that is news has to explain more than no fault and no change do
        if given is not None and _is_likelier(given, comparison, case, reference):
            progress("takes the recordings as they are: no fault explains more")
            prepared, comparison = given, _compared(given, case, reference, progress)
        # a computed torque may be explained better by another rule of the controller: then once more by that one
        changes = tuple(map(comparison.change, comparison.named))
        likelier = prepared.by_likelier_rule(changes, progress, reference.faults)
        if likelier is not None:
            comparison = _compared(likelier, case, reference, progress)
        progress("writes the findings")
        found = comparison.possible_arm
        (folder / URDF).write_bytes(found.urdf.encode())
        return Change(
            reference=reference,
            case=replace(comparison.prepared.case, arm=found.arm),
            effects=comparison.effects(comparison.named),
            remainder=found.remainder,
            comparison=comparison,
            diagnosis=diagnosis_of(comparison),
        )


def _compared(
    prepared: Prepared,
    case: Case,
    reference: KeptReference,
    progress: Callable[[str], None],
) -> Comparison:
    """The search for what the case has of its own."""
    progress("compares with the reference")
    found = _search(prepared, case, reference).run()
    return Comparison(reference, prepared, case.arm, found)


def _search(prepared: Prepared, case: Case, reference: KeptReference) -> Search:
    known = prepared.case
    rows = Rows.recorded([reference.recordings, known.recordings], known.judged)
    # what both share is free: the vendor's arm is as good a start as any
    arm = fitted_arm(rows, case.arm, {0})
    return Search(rows, arm, [(CASE,)], {0}, FRICTION_DAY_TO_DAY)


def _is_likelier(
    given: Prepared, comparison: Comparison, case: Case, reference: KeptReference
) -> bool:
    """Whether a case as it was given, without any change, is likelier than with what a comparison has found."""
    unchanged = _search(given, case, reference).unchanged()
    fault = comparison.faults_log_probability
    return unchanged > comparison.difference.fit.total + fault
