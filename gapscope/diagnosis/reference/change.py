"""What changed between a reference and a case, and the arm that predicts the case."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.case import Case
from gapscope.diagnosis.assessment.baseline import Baseline
from gapscope.diagnosis.reference.reference import IdentifiedReference
from gapscope.diagnosis.reference.reference_uncertainty import EffectColumns
from gapscope.diagnosis.result import Diagnosis
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.identification import Identification


@dataclass(frozen=True)
class Change:
    """What changed between a reference and a case.

    Attributes:
        reference: the identified arm.
        today: the identification with x as it was on the day of the case, within the reference's uncertainty.
        case: the case, its nominal arm that of today.
        baseline: effects that the arm had on the reference already, and what it leaves.
        left_open: terms that were treated as what the reference leaves open, with what they close beyond it [NRMSE].
        shift: what that move does to the torque of the case, over the joint's torque scale, (n,).
        diagnosis: of the case against all this.
    """

    reference: IdentifiedReference
    today: Identification
    case: Case
    baseline: Baseline
    left_open: tuple[tuple[EffectColumns, float], ...]
    shift: np.ndarray
    diagnosis: Diagnosis

    @property
    def corrected(self) -> tuple[AppliedEffect, ...]:
        """Effects that, with the identified arm, predict the torque recorded in the case."""
        return combined(self.baseline.effects, self.diagnosis.effects)


def combined(
    first: tuple[AppliedEffect, ...], second: tuple[AppliedEffect, ...]
) -> tuple[AppliedEffect, ...]:
    """Effects on top of others; torque offsets add up, those below a new torque scale counted by it."""
    offset = _per_joint(first, "torque_offset", "torque")
    if not offset:
        return (*first, *second)
    scale = _per_joint(second, "torque_scale", "scale")
    offset = {j: v * (1.0 + scale.get(j, 0.0)) for j, v in offset.items()}
    for j, v in _per_joint(second, "torque_offset", "torque").items():
        offset[j] = offset.get(j, 0.0) + v
    joints = tuple(sorted(offset))
    merged = AppliedEffect(
        "torque_offset", joints, {"torque": np.array([offset[j] for j in joints])}
    )
    return (merged, *(e for e in (*first, *second) if e.name != "torque_offset"))


def _per_joint(
    effects: tuple[AppliedEffect, ...], name: str, parameter: str
) -> dict[int, float]:
    """Values of a parameter by joint."""
    return {
        j: float(v)
        for e in effects
        if e.name == name
        for j, v in zip(e.joints, e.parameters[parameter], strict=True)
    }
