"""The arm of a reference: identified on its recordings, and what it shows of a healthy arm beyond that model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.diagnosis.assessment.baseline import Baseline
from gapscope.diagnosis.gap.commanded_torque import with_commanded_torque
from gapscope.diagnosis.gap.plausible_data import (
    check_rates,
    check_stamps,
    check_torque,
)
from gapscope.diagnosis.gap.plausible_motion import check_moving
from gapscope.diagnosis.reference.change import combined
from gapscope.diagnosis.reference.identified_reference import IdentifiedReference
from gapscope.diagnosis.reference.reference_fit import ReferenceFit, fit_reference
from gapscope.diagnosis.setup_faults.fault_search import looks_late
from gapscope.diagnosis.study import examine
from gapscope.ident.output.identified_arm import effects, urdf_text, with_sheet


def identify_reference(
    reference: Case, progress: Callable[[str], None] = lambda message: None
) -> IdentifiedReference:
    """Identify an arm on all recordings of a reference, and find what is inherent in it.

    Args:
        reference: the arm, known healthy and without load.
        progress: called with a few words at each step.

    Raises:
        InputError: no torque, no motion, too short, torque in another unit; says what to do.
        GapscopeError: no physically consistent parameters were found.
    """
    reference = with_commanded_torque(reference)
    check_stamps(reference)
    check_torque(reference)
    check_moving(reference)
    check_rates(reference)
    with threadpool_limits(1):
        fit = fit_reference(reference, progress)
        progress("looks for what a healthy arm of this kind has")
        return _with_inherent(_identified(fit), fit.case)


def _identified(fit: ReferenceFit) -> IdentifiedReference:
    """What a comparison needs of the identification."""
    result = fit.result
    arm, law = with_sheet(result), result.choice.law
    return IdentifiedReference(
        name=fit.case.name,
        recordings=tuple(recording.name for recording in fit.case.recordings),
        joints=arm.joints,
        gravity=arm.gravity,
        urdf=urdf_text(result),
        armature=arm.armature,
        coulomb=arm.coulomb,
        viscous=arm.viscous,
        parameters=result.columns.names(law),
        law=law,
        base_parameters=result.base.count,
        value=result.physical.value,
        precision=fit.precision,
        rest=fit.rest,
        samples=fit.samples,
        scale=fit.scale,
        skew=fit.skew,
        torque_ratio=fit.torque_ratio,
        effects=effects(result),
        warnings=result.warnings,
    )


def _with_inherent(identified: IdentifiedReference, case: Case) -> IdentifiedReference:
    """The arm with the inherent effects and the faults that a diagnosis of the reference itself finds."""
    plain = Baseline(
        identified.effects, identified.rest, identified.scale, declared=case.arm
    )
    with TemporaryDirectory(prefix="gapscope-") as folder:
        nominal = identified.on(case, Path(folder))
        study = examine(nominal, lambda message: None, plain)
        late = looks_late(nominal)
    inherent = tuple(e for e in study.effects if e.effect.inherent)
    faults = {(fault.name, fault.variant) for fault in study.faults}
    if late:
        faults.add(("late_torque", "delay"))
    return replace(
        identified,
        effects=combined(identified.effects, inherent),
        faults=frozenset(faults),
    )
