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
    IdentifiedReference,
    check_same_arm,
    identify_reference,
)
from gapscope.diagnosis.reference.reference_json import comparison_entry
from gapscope.diagnosis.reference.reference_uncertainty import (
    EffectColumns,
    ReferenceFit,
    ReferenceUncertainty,
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
        inherent = _inherent(identified, urdf, progress)
        begin = _ArmToday(identified.result, inherent)
        state, study, uncertainty = _settled(case, identified, begin, urdf, progress)
        moved = state.today.physical.value - identified.value
        change = Change(
            reference=identified,
            today=state.today,
            case=_on(case, state.today, urdf),
            baseline=state.baseline(identified),
            left_open=state.dropped,
            shift=uncertainty.torque_nrmse_of(moved),
            diagnosis=conclude(study, progress),
        )
        content = comparison_entry(change, uncertainty.covariances())
    return replace(change, diagnosis=replace(change.diagnosis, document=content))


def _settled(
    case: Case,
    identified: IdentifiedReference,
    state: _ArmToday,
    urdf: Path,
    progress: Callable[[str], None],
) -> tuple[_ArmToday, Study, ReferenceUncertainty]:
    """Diagnose, move the arm within the reference's uncertainty, and diagnose the rest, until nothing changes."""
    for turn in range(REFERENCE_ROUNDS + 1):
        nominal = _on(case, state.today, urdf)
        study = examine(nominal, progress, state.baseline(identified))
        uncertainty = ReferenceUncertainty(
            identified, state.today.physical.value, study.case, study.effects
        )
        if turn == REFERENCE_ROUNDS:
            break
        progress("weighs what the reference leaves open")
        kept, refused = uncertainty.significant_terms()
        fit = uncertainty.fit(kept)
        today = _moved(identified, state.today, fit)
        step = uncertainty.torque_nrmse_of(
            today.physical.value - state.today.physical.value
        )
        if not refused and step.max() < REFERENCE_SETTLED:
            break
        # What comes back after the arm was moved once is left open for good.
        not_named = state.not_named
        if turn > 0:
            not_named |= {(term.effect, term.joint) for term, _ in refused}
        state = _ArmToday(today, state.inherent, (*state.dropped, *refused), not_named)
    return state, study, uncertainty


@dataclass(frozen=True)
class _ArmToday:
    """The arm on the day of the case.

    Attributes:
        today: the identification, moved within the reference's uncertainty.
        inherent: effects that the arm has on the reference as well.
        dropped: terms within the reference's uncertainty, with what each closes beyond it [NRMSE].
        not_named: effect and joint of those of them that the diagnosis leaves out.
    """

    today: Identification
    inherent: tuple[AppliedEffect, ...]
    dropped: tuple[tuple[EffectColumns, float], ...] = ()
    not_named: frozenset[tuple[str, int]] = frozenset()

    def baseline(self, reference: IdentifiedReference) -> Baseline:
        """What the diagnosis takes as given."""
        given = combined(identified_effects(self.today), self.inherent)
        return Baseline(
            given, reference.rest, reference.scale, reference.skew, self.not_named
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
    identified: IdentifiedReference, urdf: Path, progress: Callable[[str], None]
) -> tuple[AppliedEffect, ...]:
    """What the reference shows of a healthy arm beyond the identified model."""
    plain = replace(_ArmToday(identified.result, ()).baseline(identified), skew=0.0)
    progress("reference: looks for what a healthy arm of this kind has")
    study = examine(
        _on(identified.case, identified.result, urdf), lambda message: None, plain
    )
    return tuple(e for e in study.effects if e.effect.inherent)


def _moved(
    reference: IdentifiedReference, today: Identification, fit: ReferenceFit
) -> Identification:
    """The identification with x moved by a fit; bodies stay physically consistent, friction and armature above zero."""
    columns, law = reference.result.columns, reference.result.choice.law
    links = columns.links
    change = fit.change.copy()
    change[:links] *= _consistent_step(reference.value[:links], change[:links])
    value = reference.value + change
    own_symbols = ("I", "b", "c")
    names = columns.names(law)
    bounded = [
        k for k, name in enumerate(names) if k >= links and name[0] in own_symbols
    ]
    value[bounded] = np.maximum(value[bounded], 0.0)
    return replace(today, physical=replace(today.physical, value=value))


def _consistent_step(inertials: np.ndarray, change: np.ndarray) -> float:
    """Share of a change of the inertials, (10 n,), by halves, with which all bodies are possible; 0 for none [1]."""
    step = 1.0
    while step > SMALLEST_STEP:
        if is_consistent((inertials + step * change).reshape(-1, 10)).all():
            return step
        step *= 0.5
    return 0.0
