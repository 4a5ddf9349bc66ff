"""What changed between a reference and a case, and the arm that predicts the case."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.reference.kept_reference import KeptReference
from gapscope.diagnosis.reference.possible_arm import PossibleArm, possible_arm
from gapscope.diagnosis.result import Diagnosis
from gapscope.diagnosis.study import Prepared
from gapscope.diagnosis.thresholds import NAMED_PROBABILITY
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.states import State
from gapscope.model.contrast import Answer
from gapscope.model.design import FreeArm, moved
from gapscope.model.difference import Difference
from gapscope.model.explained import Explained, explained
from gapscope.model.rows import Rows
from gapscope.model.terms import Candidate, Terms

FAULTY = 0.01
"""Probability that the set-up of a case has a fault that the reference does not have [1]."""
CASE = 1
"""Number of the group of the case; that of the reference is 0."""


@dataclass(frozen=True)
class Comparison:
    """The contrast of a case and a reference, n joints.

    Attributes:
        reference: the reference.
        prepared: the case as it is compared, its nominal arm the one that was identified on the reference.
        vendor: nominal arm of the case as it was declared.
        difference: what the case has of its own.
    """

    reference: KeptReference
    prepared: Prepared
    vendor: NominalArm
    difference: Difference

    @property
    def rows(self) -> Rows:
        """All rows."""
        return self.difference.fit.contrast.design.rows

    @property
    def terms(self) -> Terms:
        """All terms, with the nonlinear parameters of those that have some."""
        return self.difference.fit.contrast.design.terms

    @property
    def faults_log_probability(self) -> float:
        """Log probability of the faults that were put right [nats]; a torque in another unit has another density."""
        error = self.difference.fit.contrast.error
        # rows that count
        count = self.rows.of(CASE).sum() * error.white2 / error.noise2
        total = len(self.prepared.faults) * float(np.log(FAULTY))
        for found in self.prepared.setup_faults:
            factor = np.abs(found.reading(len(count)).torque.factor)
            total += float(count @ np.log(factor))
        return total

    @cached_property
    def findings(self) -> dict[str, list[Candidate]]:
        """What the case has of its own: the candidates of each finding."""
        found: dict[str, list[Candidate]] = {}
        for one in self.difference.fit.mine:
            found.setdefault(one.term.finding, []).append(one)
        return found

    @cached_property
    def probabilities(self) -> dict[str, float]:
        """Probability of each finding, on whatever joints, summed over the sets that compete."""
        return self.difference.probabilities_of(lambda one: one.term.finding)

    @property
    def named(self) -> tuple[str, ...]:
        """Findings that are more likely than not."""
        return tuple(
            f for f in self.findings if self.probabilities[f] >= NAMED_PROBABILITY
        )

    @property
    def possible(self) -> tuple[str, ...]:
        """The other findings of the best hypothesis."""
        return tuple(
            f for f in self.findings if self.probabilities[f] < NAMED_PROBABILITY
        )

    def of(self, names: tuple[str, ...]) -> list[Candidate]:
        """The candidates of some findings, and those that everybody has."""
        return [
            one
            for one in self.difference.fit.chosen
            if one.everybody or one.term.finding in names
        ]

    @cached_property
    def explained(self) -> Explained:
        """What the findings that are named explain of the case, each part predicted from all others."""
        return explained(self.difference.fit, CASE, self.of(self.named))

    @cached_property
    def values(self) -> Mapping[Candidate, np.ndarray]:
        """Values of what is named, and of what everybody has."""
        return self._answer.values

    @cached_property
    def _answer(self) -> Answer:
        fit = self.difference.fit
        sizes = dict(zip(fit.chosen, fit.answer.sizes, strict=True))
        some = self.of(self.named)
        return fit.own.answer(some, [sizes[one] for one in some])

    @cached_property
    def free(self) -> FreeArm:
        """The arm that predicts the reference, and the case but for its changes and what differs from day to day."""
        shared, _ = self.difference.fit.own.nuisances(self.values)
        return moved(self.difference.arm, self.difference.fit.contrast.design, shared)

    @cached_property
    def possible_arm(self) -> PossibleArm:
        """The possible arm nearest to it."""
        noise2 = self.difference.fit.contrast.error.noise2
        return possible_arm(self.free, self.prepared.case.arm, self.rows, noise2)

    def effects(self, names: tuple[str, ...] = ()) -> tuple[AppliedEffect, ...]:
        """Effects of the arm of the reference beside its data sheet, with some findings on top."""
        theta = self._theta(self.of(names), self.possible_arm.theta)
        return self.terms.effects(self.terms.clipped(theta))

    @property
    def own_theta(self) -> np.ndarray:
        """Coordinates of what is named, on top of what the arm was, (P,)."""
        named = [one for name in self.named for one in self.findings[name]]
        return self._theta(named, np.zeros(self.terms.size))

    @property
    def states(self) -> tuple[State, ...]:
        """Effects beside the data sheet in each recording and span; none if all share a state."""
        without = self._theta(self.of(()), self.possible_arm.theta)
        theta = self._theta(self.of(self.named), self.possible_arm.theta)
        return self.prepared.states.effects(self.terms, theta, without)

    def change(self, name: str) -> AppliedEffect:
        """A finding as an effect on top of what the arm was."""
        terms = [one.term for one in self.findings[name]]
        theta = self._theta(self.findings[name], np.zeros(self.terms.size))
        (applied,) = self.terms.effects(theta, terms)
        return applied

    def _theta(self, some: list[Candidate], theta: np.ndarray) -> np.ndarray:
        """Coordinates of effects with the values of some candidates added, (P,)."""
        theta = theta.copy()
        values = {**self.difference.fit.answer.values, **self.values}
        for one in some:
            theta[list(one.term.columns)] += values[one]
        return theta

    @property
    def before(self) -> CorrectedArm:
        """The arm of the reference, which only predicts; beside ``free.bodies``."""
        return self._predicting(())

    @property
    def after(self) -> CorrectedArm:
        """The same with what is named."""
        return self._predicting(self.named)

    def _predicting(self, names: tuple[str, ...]) -> CorrectedArm:
        theta = self._theta(self.of(names), self.free.theta)
        return self.free.corrected(self.terms, self.terms.clipped(theta))

    def sheet(self, day: int | None = None) -> dict[str, np.ndarray]:
        """Armature, Coulomb and viscous friction that were identified, or on the day of a group, (n,) each."""
        design = self.difference.fit.contrast.design
        _, days = self.difference.fit.own.nuisances(self.values)
        out: dict[str, np.ndarray] = {}
        for term in design.places:
            name = term.parametrisation.data_sheet
            if name is None:
                continue
            (place,) = design.places[term]
            value = self.free.theta[term.columns[0]]
            if day is not None:
                value += days[day, place] / design.units[term][0]
            out.setdefault(name, np.zeros(self.vendor.n_joints))[term.joint - 1] = value
        return out


@dataclass(frozen=True)
class Change:
    """What changed between a reference and a case.

    Attributes:
        reference: the reference.
        case: the case, its nominal arm the possible one nearest to what predicts.
        effects: that, with this arm and ``remainder``, predict the torque recorded in the case.
        remainder: of the inertial parameters of each link, which a possible arm lacks to predict best, (n, 10).
        comparison: of which all follows.
        diagnosis: written from it.
    """

    reference: KeptReference
    case: Case
    effects: tuple[AppliedEffect, ...]
    remainder: np.ndarray
    comparison: Comparison
    diagnosis: Diagnosis

    @property
    def corrected(self) -> CorrectedArm:
        """The arm that predicts the torque recorded in the case."""
        states = self.diagnosis.states
        last = states[-1].effects if states else self.effects
        remainder = self.remainder
        return CorrectedArm(self.case.arm, last, remainder=remainder, states=states)
