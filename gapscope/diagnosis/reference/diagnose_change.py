"""What changed: the gap of a case against the arm identified on a reference, within what the reference leaves open."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.diagnosis.assessment.baseline import Baseline
from gapscope.diagnosis.diagnose import Study, conclude, examine
from gapscope.diagnosis.gap.commanded_torque import with_commanded_torque
from gapscope.diagnosis.reference.change import Change, combined
from gapscope.diagnosis.reference.reference import (
    Reference,
    check_same_arm,
    identify_reference,
)
from gapscope.diagnosis.reference.reference_json import comparison_entry
from gapscope.diagnosis.reference.reference_uncertainty import (
    Fit,
    ReferenceUncertainty,
    Term,
)
from gapscope.diagnosis.thresholds import (
    REFERENCE_INERTIAL_FACTOR,
    REFERENCE_ROUNDS,
    REFERENCE_SETTLED,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.identification import Identification
from gapscope.ident.model.pseudo_inertia import is_consistent
from gapscope.ident.output.identified_arm import effects as identified_effects
from gapscope.ident.output.identified_arm import sheet, urdf_text

SMALLEST_STEP = 1e-6
"""Steps back towards the identified bodies end here [1]."""


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
    with threadpool_limits(1):
        identified = identify_reference(
            reference, lambda message: progress(f"reference: {message}")
        )
        urdf = folder / "identified.urdf"
        begin = _State(identified.result, _inherent(identified, urdf, progress))
        state, study, leeway = _settled(case, identified, begin, urdf, progress)
        shift = leeway.does(state.today.physical.value - identified.value)
        final, baseline = _on(case, state.today, urdf), state.baseline(identified)
        diagnosis = conclude(study, progress)
        change = Change(
            identified, state.today, final, baseline, state.dropped, shift, diagnosis
        )
        content = comparison_entry(change, leeway.covariances())
    return replace(change, diagnosis=replace(diagnosis, document=content))


def _settled(
    case: Case,
    identified: Reference,
    state: _State,
    urdf: Path,
    progress: Callable[[str], None],
) -> tuple[_State, Study, ReferenceUncertainty]:
    """Diagnose, move the arm within the reference uncertainty, and diagnose the rest, until nothing changes."""
    for turn in range(REFERENCE_ROUNDS + 1):
        study = examine(
            _on(case, state.today, urdf), progress, state.baseline(identified)
        )
        leeway = ReferenceUncertainty(
            identified, state.today.physical.value, study.case, study.effects
        )
        if turn == REFERENCE_ROUNDS:
            break
        progress("weighs what the reference leaves open")
        kept, refused = leeway.news()
        moved, step = _moved(identified, state.today, leeway.fit(kept), leeway)
        if not refused and step.max() < REFERENCE_SETTLED:
            break
        again = (
            frozenset((t.effect, t.joint) for t, _ in refused) if turn else frozenset()
        )
        state = replace(
            state,
            today=moved,
            dropped=(*state.dropped, *refused),
            open=state.open | again,
        )
    return state, study, leeway


@dataclass(frozen=True)
class _State:
    """The arm of today, effects that it has anyway, terms taken for leeway, and those of them that are not named."""

    today: Identification
    inherent: tuple[AppliedEffect, ...]
    dropped: tuple[tuple[Term, float], ...] = ()
    open: frozenset[tuple[str, int]] = frozenset()

    def baseline(self, reference: Reference) -> Baseline:
        """What the diagnosis takes as given."""
        given = combined(identified_effects(self.today), self.inherent)
        return Baseline(
            given, reference.rest, reference.scale, reference.skew, self.open
        )


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
        inertial_error_factor=REFERENCE_INERTIAL_FACTOR,
    )
    return replace(case, arm=arm)


def _inherent(
    identified: Reference, urdf: Path, progress: Callable[[str], None]
) -> tuple[AppliedEffect, ...]:
    """What the reference shows of a healthy arm beyond the identified model."""
    plain = replace(_State(identified.result, ()).baseline(identified), skew=0.0)
    progress("reference: looks for what a healthy arm of this kind has")
    study = examine(
        _on(identified.case, identified.result, urdf), lambda message: None, plain
    )
    return tuple(e for e in study.effects if e.effect.inherent)


def _moved(
    reference: Reference, today: Identification, fit: Fit, leeway: ReferenceUncertainty
) -> tuple[Identification, np.ndarray]:
    """The identification with x moved within the leeway, bodies still possible; and torque NRMSE of the step, (n,)."""
    before, names = (
        reference.value,
        reference.result.columns.names(reference.result.choice.law),
    )
    links, step, change = reference.result.columns.links, 1.0, fit.change.copy()
    while (
        step > SMALLEST_STEP
        and not is_consistent((before + step * change)[:links].reshape(-1, 10)).all()
    ):
        step *= 0.5
    change[:links] *= step if step > SMALLEST_STEP else 0.0
    value = before + change
    bounded = [k for k, name in enumerate(names) if k >= links and name[0] in "Ibc"]
    value[bounded] = np.maximum(value[bounded], 0.0)
    moved = replace(today, physical=replace(today.physical, value=value))
    return moved, leeway.does(value - today.physical.value)
