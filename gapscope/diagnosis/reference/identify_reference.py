"""A reference made ready: recordings of a healthy arm, faults of the set-up put right, and its nearest possible arm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.arm.recording import Recording
from gapscope.diagnosis.gap.commanded_torque import with_commanded_torque
from gapscope.diagnosis.gap.excerpt import excerpt
from gapscope.diagnosis.gap.plausible_data import (
    check_rates,
    check_stamps,
    check_torque,
)
from gapscope.diagnosis.gap.plausible_motion import (
    check_moving,
    short_note,
    still_note,
)
from gapscope.diagnosis.reference.kept_reference import KeptReference
from gapscope.diagnosis.reference.possible_arm import possible_arm
from gapscope.diagnosis.setup_faults.detection import find_setup_faults
from gapscope.diagnosis.setup_faults.fault_search import looks_late
from gapscope.diagnosis.setup_faults.found_fault import repaired
from gapscope.diagnosis.setup_faults.quantization import find_quantization
from gapscope.model.design import design, fitted_arm
from gapscope.model.equations import Equations
from gapscope.model.form_error import learn
from gapscope.model.rows import Rows


def identify_reference(
    reference: Case, progress: Callable[[str], None] = lambda message: None
) -> KeptReference:
    """Make a reference ready: whatever shows on it is no change.

    Args:
        reference: the arm, known healthy and without load.
        progress: called with a few words at each step.

    Raises:
        InputError: no torque, no motion, too short, torque in another unit; says what to do.
        GapscopeError: no physically consistent bodies were found.
    """
    reference = with_commanded_torque(reference)
    check_stamps(reference)
    check_torque(reference)
    check_moving(reference)
    check_rates(reference)
    with threadpool_limits(1):
        progress("identifies the arm")
        kept = _kept(excerpt(reference))
        progress("tests the set-up")
        with TemporaryDirectory(prefix="gapscope-") as folder:
            nominal = kept.on(reference, Path(folder))
            # the gravity of an arm that was identified on a torque is in that torque
            faults = tuple(
                fault
                for fault in find_setup_faults(nominal)
                if not fault.reading(reference.arm.n_joints).differs("gravity")
            )
            right = excerpt(repaired(nominal, faults))
            faults = (*faults, *find_quantization(right))
            late = looks_late(nominal)
        if faults:
            # of what is put right here, the case shows the same against the arm that is right
            kept = _kept(replace(right, arm=reference.arm))
    names = {(fault.name, fault.variant) for fault in faults}
    if late:
        names.add(("late_torque", "delay"))
    return replace(
        kept,
        recordings=tuple(r for r in right.recordings if r.tau is not None),
        faults=frozenset(names),
        warnings=(
            *still_note(reference),
            *short_note(reference),
            *_single_note(right.recordings),
        ),
    )


def _single_note(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """A sentence on a reference of one recording."""
    if len([r for r in recordings if r.tau is not None]) > 1:
        return ()
    return (
        "one recording does not show how differently the model misses other motions, which then looks like a change: "
        "record the healthy arm in two other motions at least, or take what is found as a suspicion",
    )


def _kept(reference: Case) -> KeptReference:
    """The reference as it was recorded, with the possible arm that predicts it best."""
    rows = Rows.recorded([reference.recordings])
    free = fitted_arm(rows, reference.arm, {0})
    noise2 = learn(Equations.of(design(rows, free, {})), {0}).noise2
    found = possible_arm(free, reference.arm, rows, noise2)
    return KeptReference(
        name=reference.name,
        joints=reference.arm.joints,
        coupled_motors=reference.arm.coupled_motors,
        gravity=reference.arm.gravity,
        urdf=found.urdf,
        armature=found.arm.armature,
        coulomb=found.arm.coulomb,
        viscous=found.arm.viscous,
        recordings=reference.recordings,
    )
