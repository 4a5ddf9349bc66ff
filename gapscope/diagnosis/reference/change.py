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
    offsets = [e for e in first if "offset" in e.effect.quantities.values()]
    if not offsets:
        return (*first, *second)
    name, parameter = offsets[0].name, offsets[0].effect.names[0]
    joints = sorted({j for e in (*first, *second) if e.name == name for j in e.joints})
    n = max(joints)
    below, above = (
        sum((e.per_joint(parameter, n) for e in some if e.name == name), np.zeros(n))
        for some in (first, second)
    )
    scale = np.zeros(n)
    for applied in second:
        if "scale" in applied.effect.quantities.values():
            own = applied.parameters[applied.effect.names[0]]
            for joint, value in zip(applied.joints, own, strict=True):
                if joint <= n:
                    scale[joint - 1] += value
    total = below * (1.0 + scale) + above
    places = np.array(joints) - 1
    merged = AppliedEffect(name, tuple(joints), {parameter: total[places]})
    return (merged, *(e for e in (*first, *second) if e.name != name))
