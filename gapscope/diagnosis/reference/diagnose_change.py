"""What changed: the gap of a case against the arm identified on a reference, within what the reference leaves open.

The gap y of the case against the identified arm is taken as

    y_j = A_j theta + W_j nu + g_j eps_j + d_j T + noise

with A theta what effects do, nu the error of the identified parameters on the day of the case, whose covariance the
reference gives and to which friction adds what differs from day to day, g_j what effects on bodies add on joint j, of
which the gain of its recorded torque is known to eps_j alone, and T a skew of sampling. An effect is a change only if
the evidence for it exceeds what these explain. Whatever belongs to how the arm was built is not expected to change.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.diagnosis.assessment.baseline import Baseline
from gapscope.diagnosis.diagnose import conclude, examine
from gapscope.diagnosis.gap.commanded_torque import with_commanded_torque
from gapscope.diagnosis.reference.change import Change
from gapscope.diagnosis.reference.identified_reference import IdentifiedReference
from gapscope.diagnosis.reference.reference_errors import reference_errors
from gapscope.diagnosis.reference.reference_json import comparison_entry
from gapscope.diagnosis.reference.same_arm import (
    check_same_joints,
    check_same_places,
    place_of,
)


def diagnose_change(
    case: Case,
    reference: IdentifiedReference,
    folder: Path,
    progress: Callable[[str], None] = lambda message: None,
) -> Change:
    """Attribute the gap of a case against the arm identified on a reference.

    Args:
        case: the case.
        reference: the same arm, identified when it was known to be healthy and without load.
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
        baseline = Baseline(
            reference.effects,
            reference.rest,
            reference.scale,
            reference.skew,
            reference_errors(reference, nominal.arm),
            reference.faults,
            case.arm,
        )
        study = examine(nominal, progress, baseline)
        change = Change(
            reference=reference,
            case=nominal,
            baseline=baseline,
            study=study,
            diagnosis=conclude(study, progress),
        )
        content = comparison_entry(change)
    return replace(change, diagnosis=replace(change.diagnosis, document=content))
