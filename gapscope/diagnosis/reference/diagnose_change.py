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

import numpy as np
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.diagnosis.assessment.baseline import Baseline
from gapscope.diagnosis.diagnose import conclude, examine
from gapscope.diagnosis.gap.commanded_torque import with_commanded_torque
from gapscope.diagnosis.gap.plausible_data import (
    check_rates,
    check_stamps,
    check_torque,
)
from gapscope.diagnosis.reference.change import Change, combined
from gapscope.diagnosis.reference.reference import (
    IdentifiedReference,
    check_same_arm,
    identify_reference,
)
from gapscope.diagnosis.reference.reference_errors import reference_errors
from gapscope.diagnosis.reference.reference_json import comparison_entry
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.identification import Identification
from gapscope.ident.output.identified_arm import effects as identified_effects
from gapscope.ident.output.identified_arm import sheet, urdf_text


def diagnose_change(
    case: Case,
    reference: Case,
    folder: Path,
    progress: Callable[[str], None] = lambda message: None,
) -> Change:
    """Identify the arm on the reference and attribute the gap of the case against it.

    Args:
        case: the case.
        reference: the same arm, known healthy and without load.
        folder: where the URDF of the identified arm is written, ``identified.urdf``.
        progress: called with a few words at each step.

    Raises:
        InputError: the reference is another robot, or nothing can be identified from its recordings.
        GapscopeError: no physically consistent parameters were found, or the case cannot be diagnosed.
    """
    case, reference = with_commanded_torque(case), with_commanded_torque(reference)
    check_same_arm(case, reference)
    check_stamps(reference)
    check_torque(reference)
    check_rates(reference)
    with threadpool_limits(1):
        identified = identify_reference(
            reference, lambda message: progress(f"reference: {message}")
        )
        urdf = folder / "identified.urdf"
        given = _given(identified, urdf, progress)
        baseline = replace(given, errors=reference_errors(identified))
        nominal = _on(case, identified.result, urdf)
        study = examine(nominal, progress, baseline)
        change = Change(
            reference=identified,
            case=nominal,
            baseline=baseline,
            study=study,
            diagnosis=conclude(study, progress),
        )
        content = comparison_entry(change)
    return replace(change, diagnosis=replace(change.diagnosis, document=content))


def _on(case: Case, result: Identification, urdf: Path) -> Case:
    """The case with the identified arm as its nominal one; nothing is replayed, see ``docs/reference_case.md``."""
    urdf.write_text(urdf_text(result), encoding="utf-8")
    section = sheet(result)
    armature, coulomb, viscous = (
        np.array(section[name]) for name in ("armature", "coulomb", "viscous")
    )
    arm = replace(
        case.arm,
        urdf=urdf,
        armature=armature,
        coulomb=coulomb,
        viscous=viscous,
        friction_source="the reference, identified",
    )
    return replace(case, arm=arm)


def _given(
    identified: IdentifiedReference, urdf: Path, progress: Callable[[str], None]
) -> Baseline:
    """The arm on the reference: as identified, and what it shows of a healthy arm beyond the identified model."""
    plain = Baseline(
        tuple(identified_effects(identified.result)),
        identified.rest,
        identified.scale,
    )
    progress("reference: looks for what a healthy arm of this kind has")
    study = examine(
        _on(identified.case, identified.result, urdf), lambda message: None, plain
    )
    inherent: tuple[AppliedEffect, ...] = tuple(
        e for e in study.effects if e.effect.inherent
    )
    return replace(
        plain,
        effects=combined(plain.effects, inherent),
        skew=identified.skew,
        faults=frozenset((fault.name, fault.variant) for fault in study.faults),
    )
