"""What changed between a reference and a case, and the arm that predicts the case."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.case import Case
from gapscope.diagnosis.assessment.baseline import Baseline
from gapscope.diagnosis.reference.identified_reference import IdentifiedReference
from gapscope.diagnosis.result import Diagnosis
from gapscope.diagnosis.study import Study
from gapscope.effects.applied import AppliedEffect


@dataclass(frozen=True)
class Change:
    """What changed between a reference and a case.

    Attributes:
        reference: the identified arm.
        case: the case, its nominal arm the identified one.
        baseline: effects that the arm had on the reference already, and what it leaves.
        study: of the case against all this.
        diagnosis: written from it.
    """

    reference: IdentifiedReference
    case: Case
    baseline: Baseline
    study: Study
    diagnosis: Diagnosis

    @property
    def error(self) -> np.ndarray:
        """Likeliest error of the identified parameters on the day of the case, (p,)."""
        evidence, fit = self.study.selection.evidence, self.study.selection.fit
        delta = evidence.nuisances(fit.terms)
        units = evidence.linear.data.units
        size = len(self.reference.value)
        return np.concatenate([units * delta[: len(units)], delta[len(units) : size]])

    @property
    def shift(self) -> np.ndarray:
        """What that error does to the torque of the case, over the joint's torque scale, (n,)."""
        data = self.study.selection.evidence.linear.data
        inertials = len(data.units)
        delta = self.study.selection.evidence.nuisances(self.study.selection.fit.terms)
        torque = [
            n @ delta[:inertials] + own @ delta[inertials : inertials + own.shape[2]]
            for n, own in zip(data.nuisance, data.own, strict=True)
        ]
        rms = np.sqrt((np.vstack(torque) ** 2).mean(axis=0))
        return np.asarray(rms / data.torque_deviation)

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
