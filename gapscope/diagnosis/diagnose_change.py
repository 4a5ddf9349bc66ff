"""A diagnosis against a reference: what the same arm has now that it had not then, as a document."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm, arm_entry
from gapscope.diagnosis.assessment.confidence import NONE, Alternative
from gapscope.diagnosis.document.diagnosis_json import nominal_friction, recording_entry
from gapscope.diagnosis.document.expected import expected_entries
from gapscope.diagnosis.document.findings import (
    LISTED_ALTERNATIVE,
    GapStages,
    alternative_entry,
    numbers,
    region_entry,
    states_entry,
    std_of_draws,
    suggested_recording,
    with_faults,
    with_states,
)
from gapscope.diagnosis.document.plotted_curves import (
    located,
    signatures,
    spectrum,
    traces,
)
from gapscope.diagnosis.document.wording import verdict, with_slide_units
from gapscope.diagnosis.gap.commanded_torque import WARNING, with_commanded_torque
from gapscope.diagnosis.gap.plausible_data import short_note, still_note
from gapscope.diagnosis.locate import MotionRows, regions
from gapscope.diagnosis.reference_file import (
    URDF,
    KeptReference,
    PossibleArm,
    possible_arm,
)
from gapscope.diagnosis.result import Diagnosis
from gapscope.diagnosis.study import Prepared, prepare
from gapscope.diagnosis.thresholds import (
    EXPLAINED_RESIDUAL,
    FALSE_DISCOVERY_RATE,
    FRICTION_DAY_TO_DAY,
    NAMED_PROBABILITY,
    SAME_GRAVITY,
    SAME_JOINT_PLACE,
    SIGNIFICANT_RESIDUAL_RATIO,
)
from gapscope.effects.applied import AppliedEffect, State
from gapscope.effects.catalogue import known_effect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import LinkChange
from gapscope.model.change_findings import change_findings
from gapscope.model.conditioning import TORQUE_CUTOFF
from gapscope.model.contrast import Answer
from gapscope.model.design import FreeArm, fitted_arm, moved
from gapscope.model.difference import Difference, Search
from gapscope.model.expected import detectable
from gapscope.model.explained import Explained, explained
from gapscope.model.rows import Rows
from gapscope.model.terms import Candidate, Term, Terms
from gapscope.model.torque_gap import torque_gap

# Whether a case and a reference are of the same arm.


def place_of(reference: Case | KeptReference) -> str:
    """How messages call a reference: by its file, or by its name."""
    return f"--against {reference.file or reference.name}"


def check_same_joints(case: Case, reference: Case | KeptReference) -> None:
    """Check that number, names and order of the joints, coupled motors, and gravity, agree.

    Raises:
        InputError: they do not.
    """
    arm = reference.arm if isinstance(reference, Case) else reference
    place = place_of(reference)
    ours, theirs = list(case.arm.joints), list(arm.joints)
    if len(ours) != len(theirs):
        raise InputError(
            f"has {len(theirs)} joints, {case.name} has {len(ours)}: another robot",
            "give a reference of the same arm",
            where=place,
        )
    if ours != theirs:
        reordered = sorted(ours) == sorted(theirs)
        how = "in another order" if reordered else "with other names"
        raise InputError(
            f"has its joints {how}: {', '.join(theirs)}; {case.name} has {', '.join(ours)}",
            "give a reference of the same arm, with joints: in the order of the case",
            where=place,
        )
    if case.arm.coupled_motors != arm.coupled_motors:
        raise InputError(
            f"has coupled motors {list(arm.coupled_motors)}, {case.name} has {list(case.arm.coupled_motors)}",
            "declare the same coupling in both cases, and identify the reference again",
            where=place,
        )
    if not np.allclose(case.arm.gravity, arm.gravity, atol=SAME_GRAVITY):
        raise InputError(
            f"has gravity {arm.gravity.tolist()}, {case.name} has {case.arm.gravity.tolist()}",
            "give a reference that was recorded in the same mounting, or correct gravity:",
            where=place,
        )


def check_same_places(case: Case, arm: NominalArm, place: str) -> None:
    """Check that the joints of two arms lie in the same places.

    Args:
        case: the case.
        arm: arm of the reference, vendor's or identified; both have the same kinematics.
        place: how messages call the reference.

    Raises:
        InputError: they do not.
    """
    if _joint_distance(case.arm, arm) > SAME_JOINT_PLACE:
        raise InputError(
            "has joints of the same names in other places: another robot, or another version of its URDF",
            "give a reference of the same arm, and both cases the same kinematics",
            where=place,
        )


def check_same_arm(case: Case, reference: Case) -> None:
    """Check that two cases are of the same arm, joint by joint.

    Raises:
        InputError: another number of joints, other names, another order, another gravity, or joints in other places.
    """
    check_same_joints(case, reference)
    check_same_places(case, reference.arm, place_of(reference))


def _joint_distance(one: NominalArm, other: NominalArm) -> float:
    """Largest difference of the joints' places, in any coordinate [m] or entry of the rotation [1]."""
    ours, theirs = RigidBody(one).model, RigidBody(other).model
    largest = 0.0
    for a, b in zip(ours.jointPlacements, theirs.jointPlacements, strict=True):
        moved = np.abs(a.translation - b.translation).max()
        turned = np.abs(a.rotation - b.rotation).max()
        largest = max(largest, float(moved), float(turned))
    return largest


# What changed between a reference and a case, and the arm that predicts the case.


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


# ``diagnosis.json`` of a comparison with a reference, and the curves that its report draws.


SCALED = (
    "masses are measured with the torque of the reference: were its torque constants wrong by a factor on all joints, "
    "the identified masses and the load found would be wrong by the same factor"
)
"""Warning given with each load found."""
IN_TEN = 0.9
"""A finding's names together hold the true one in nine of ten cases. (definition)"""
DRAWS = 200
"""Draws of the values. (budget)"""
GROWTHS = tuple(4.0**k for k in range(1, 7))
"""Growths of form error [1] that are tried in place of a finding: of its torque 2 to 64 times. (budget)"""


def diagnosis_of(comparison: Comparison) -> Diagnosis:
    """The diagnosis of a comparison."""
    document = _Document(comparison)
    content = document.content()
    segments = [
        segment
        for k, segment in enumerate(comparison.rows.segments)
        if comparison.rows.group_of[k] == CASE
        and comparison.explained.rows[comparison.rows.segment == k].all()
    ]
    before, after, body = comparison.before, comparison.after, comparison.free.bodies
    gaps = {
        "before": torque_gap(before, body, segments),
        "after": torque_gap(after, body, segments),
    }
    floor, rates = comparison.explained.floor, tuple(s.motion.rate for s in segments)
    order = [finding["effect"] for finding in content["effects"]]
    named = sorted(
        map(comparison.change, comparison.named), key=lambda e: order.index(e.name)
    )
    shown = {effect.name for effect in named}
    return Diagnosis(
        document=content,
        effects=tuple(named),
        traces=traces(before, after, body, segments),
        signatures=signatures(after, body, segments, shown),
        spectrum=spectrum(gaps["before"], gaps["after"], rates),
        located=located(content, gaps, floor, segments),
        possible=tuple(map(comparison.change, comparison.possible)),
        presliding=tuple(comparison.vendor.presliding.tolist()),
        faults=comparison.prepared.faults,
        arm=comparison.possible_arm.arm,
        states=comparison.states,
    )


class _Document:
    """Parts of the document of a comparison."""

    def __init__(self, comparison: Comparison) -> None:
        self._comparison, self._explained = comparison, comparison.explained
        self._fit = comparison.difference.fit
        self._load = self._explained.before - self._explained.after
        self._rows = _motion_rows(comparison)
        self._draws = _drawn(self._fit.answer, np.random.default_rng(0))

    def content(self) -> dict[str, Any]:
        """The whole document."""
        comparison, prepared = self._comparison, self._comparison.prepared
        gap = self._stages()
        found = [self._finding(name) for name in comparison.named]
        here = with_faults(_by_share(found), prepared.faults, gap)
        effects = with_states(
            here, prepared.states, comparison.terms, comparison.own_theta
        )
        possible = _by_share([self._finding(name) for name in comparison.possible])
        open_joints = self._open_joints()
        reach = partial(
            verdict,
            explained=self._leaves_little(open_joints),
            significant=bool(open_joints),
            rejected=False,
        )
        reached = reach(found=bool(effects or prepared.changes))
        # where the arm was compared nothing need have changed
        closed = gap.closed if reach(found=bool(here)) == reached else None
        unexplained = open_joints if reached == "unexplained" else []
        content = {
            "schema": 1,
            "case": prepared.case.name,
            "verdict": reached,
            "gap": _gap_entry(gap),
            "effects": effects,
            "possible": possible,
            "changes": change_findings(prepared.changes),
            **states_entry(prepared.states.found),
            "closed": closed,
            "unexplained": {
                "share": 0.0 if closed is None else 1.0 - closed,
                "above_floor": bool(unexplained),
                "joints": open_joints,
                "times_floor": numbers(gap.corrected / gap.floor),
                "where": self._where(self._explained.after, open_joints),
                "predictable": [],
                "coupling": None,
            },
            "next_recording": suggested_recording(
                reached, effects, possible, unexplained
            ),
            "where": self._where(self._explained.before, _widest_first(gap)),
            "against": self._against(),
        }
        content |= self._context()
        return with_slide_units(content, comparison.vendor.sliding)

    def _stages(self) -> GapStages:
        known = self._explained
        repaired = known.nrmse(known.before)
        faults = self._comparison.prepared.faults
        recorded = [f.gap_before for f in faults if f.gap_before is not None]
        return GapStages(
            recorded=recorded[0] if recorded else repaired,
            repaired=repaired,
            corrected=known.nrmse(known.after),
            floor=known.floor / known.scale,
        )

    def _open_joints(self) -> list[int]:
        """Joints, from 1, with something unknown: form error is larger than on the reference, and far above it."""
        grown = sorted({j for j, *_ in self._fit.grown})
        known = self._explained
        ratio = np.sqrt((known.after**2).mean(axis=0)) / known.floor
        return [j + 1 for j in grown if ratio[j] >= SIGNIFICANT_RESIDUAL_RATIO]

    def _leaves_little(self, joints: list[int]) -> bool:
        """Whether the gap that is left above the floor is a small part of what there was, on some joints."""
        places, floor2 = np.array(joints, dtype=int) - 1, self._explained.floor**2
        before2, after2 = (
            np.clip((gap**2).mean(axis=0) - floor2, 0.0, None)[places]
            for gap in (self._explained.before, self._explained.after)
        )
        return bool(after2.sum() <= EXPLAINED_RESIDUAL * before2.sum())

    def _finding(self, name: str) -> dict[str, Any]:
        """Evidence, values, gaps and places of a finding."""
        comparison, known = self._comparison, self._explained
        mine, applied = comparison.findings[name], comparison.change(name)
        known_torque = {
            one: known.torque[one] if one in known.torque else self._torque(one)
            for one in mine
        }
        own = np.asarray(sum(known_torque.values()))
        in_model = name in comparison.named
        only = known.before - own
        without = known.after + own if in_model else known.after
        left = known.after if in_model else known.after - own
        probability = comparison.probabilities[name]
        alternatives = self._alternatives(name)
        closed = np.sqrt(np.clip(without**2 - left**2, 0.0, None))
        joints = list(applied.joints) or self._most_closed(closed)
        return {
            "effect": applied.name,
            "joints": list(applied.joints),
            "probability": probability,
            "set": _names(applied.name, probability, alternatives),
            "support": self._support(name),
            "gap_with_only_this": {"torque_nrmse": numbers(known.nrmse(only))},
            "gap_without_this": {"torque_nrmse": numbers(known.nrmse(without))},
            "where": [
                region_entry(region)
                for region in regions(closed, self._rows, self._load, joints, most=1)
            ],
            "alternatives": [alternative_entry(applied.name, a) for a in alternatives],
            "carried_by": self._carried_by(closed),
            "parameters": self._parameters(name),
            **self._share(only, without, left),
            **self._significance(name),
        }

    def _torque(self, one: Candidate) -> np.ndarray:
        """What a candidate that is not named does to the torque [N m], (M, n)."""
        torque = self._fit.own.torque({one: self._fit.answer.values[one]})
        rows, mine = self._comparison.rows, self._explained.rows
        return (torque * rows.measured / rows.trust)[mine] * rows.scale

    def _share(
        self, only: np.ndarray, without: np.ndarray, left: np.ndarray
    ) -> dict[str, Any]:
        """Share of the gap that a finding closes: the mean of what it does first and last (Shapley of two orders)."""
        known = self._explained
        first = known.nrmse(known.before) - known.nrmse(only)
        last = known.nrmse(without) - known.nrmse(left)
        whole = max(self._stages().whole, 1e-9)
        ends = np.clip(np.sort([first.sum(), last.sum()]) / whole, 0.0, 1.0)
        return {"share": float(ends.mean()), "share_interval": ends.tolist()}

    def _significance(self, name: str) -> dict[str, Any]:
        """Evidence for a finding, and the share of false ones among those as sure."""
        probabilities = self._comparison.probabilities
        as_sure = [
            1.0 - probabilities[other]
            for other in self._comparison.findings
            if probabilities[other] >= probabilities[name]
        ]
        rate = float(np.mean(as_sure))
        return {
            "log_e": self._log_odds(name),
            "false_discovery_rate": rate,
            "confirmed": rate <= FALSE_DISCOVERY_RATE,
        }

    def _log_odds(self, name: str) -> float:
        """Log probability of the sets with a finding over that of those without [nats]."""
        return self._comparison.difference.log_odds(
            lambda one: one.term.finding == name
        )

    def _support(self, name: str) -> dict[str, float]:
        """What it takes to overturn a finding: log odds [nats], and how much larger form error would explain it."""
        out = {"log_odds": self._log_odds(name)}
        values = {
            one: value
            for one, value in self._fit.answer.values.items()
            if one.term.finding != name
        }
        left = self._fit.contrast.gap - self._fit.own.torque(values)
        gains = self._fit.contrast.for_gap(left).growth_gains(CASE, GROWTHS)
        needed = out["log_odds"]
        for growth in GROWTHS:
            by_joint: dict[int, float] = {}
            for (j, _, tried), gain in gains.items():
                if tried == growth:
                    by_joint[j] = by_joint.get(j, 0.0) + gain
            if sum(max(gain, 0.0) for gain in by_joint.values()) >= needed:
                out["form_error_instead"] = float(np.sqrt(growth))
                break
        return out

    def _carried_by(self, closed: np.ndarray) -> dict[str, Any]:
        """Shares of the squares that a finding closes, over the noise: by joint, and by recording."""
        noise2 = self._fit.contrast.error.noise2 * self._comparison.rows.scale**2
        nats = closed**2 / noise2
        total = max(float(nats.sum()), 1e-300)
        segments = self._rows.segment
        recordings: dict[str, float] = {}
        for k, name in enumerate(self._rows.names):
            share = float(nats[segments == k].sum()) / total
            recordings[name] = recordings.get(name, 0.0) + share
        return {
            "joints": numbers(nats.sum(axis=0) / total),
            "recordings": recordings,
        }

    def _parameters(self, name: str) -> dict[str, Any]:
        """Values with their standard deviations."""
        applied = self._comparison.change(name)
        terms = [one.term for one in self._comparison.findings[name]]
        found = [self._comparison.difference.found.get(term) for term in terms]
        fitted = terms[0].parametrisation
        shape = np.array([f.values for f in found if f]).T
        samples = [
            dict(fitted.values(np.stack([draw[t] for t in terms], axis=1), shape))
            for draw in self._draws
        ]
        out = {}
        for parameter in applied.effect.parameters:
            value = applied.parameters[parameter.name]
            if parameter.name in fitted.nonlinear:
                place = fitted.nonlinear.index(parameter.name)
                std = np.array([f.deviations[place] for f in found if f])
            elif parameter.name == "link":
                std = np.zeros(1)
            else:
                std = std_of_draws(parameter, value, samples)
            out[parameter.name] = {
                "unit": parameter.unit,
                "value": value.tolist(),
                "std": std.reshape(value.shape).tolist(),
            }
        return out

    def _alternatives(self, name: str) -> list[Alternative]:
        """What the sets without a finding have in its place, with their probabilities."""
        sets = self._comparison.difference.sets
        total = float(np.logaddexp.reduce(list(sets.values())))
        best = {one.term.finding for one in self._fit.mine}
        places: dict[str, tuple[float, set[int]]] = {}
        for some, value in sets.items():
            if any(one.term.finding == name for one in some):
                continue
            others = [one.term for one in some if one.term.finding not in best]
            effect = min((term.effect for term in others), default=NONE)
            joints = {t.joint for t in others if t.effect == effect and t.joint}
            known, known_joints = places.get(effect, (0.0, set()))
            probability = known + float(np.exp(value - total))
            places[effect] = probability, known_joints | joints
        given = max(self._comparison.probabilities[name], LISTED_ALTERNATIVE)
        ranked = [
            Alternative(effect, tuple(sorted(joints)), p, float(np.log(p / given)))
            for effect, (p, joints) in places.items()
            if p > LISTED_ALTERNATIVE
        ]
        return sorted(ranked, key=lambda other: -other.probability)

    def _most_closed(self, closed: np.ndarray) -> list[int]:
        """The two joints, from 1, on which most is closed."""
        most = np.argsort(-(closed**2).sum(axis=0))[:2]
        return [int(j) + 1 for j in most]

    def _where(self, error: np.ndarray, joints: list[int]) -> list[dict[str, Any]]:
        """Regions in which a gap is concentrated."""
        places = regions(error, self._rows, self._load, joints)
        return [region_entry(region) for region in places]

    def _against(self) -> dict[str, Any]:
        """What was identified on the reference, per joint, and what was allowed for on the day of the case."""
        comparison, contrast = self._comparison, self._fit.contrast
        rows, reference = comparison.rows, comparison.reference
        _, days = self._fit.own.nuisances(comparison.values)
        day = contrast.design.shared_torque(days[CASE])[self._explained.rows]
        held_out = np.sqrt(contrast.error.missed2) * rows.scale
        possible = comparison.possible_arm
        return {
            "reference": reference.name,
            "recordings": [recording.name for recording in reference.recordings],
            "made_from": dict(reference.made_from),
            "identified": _listed(comparison.sheet()),
            "identified_std": _listed(self._sheet_deviations()),
            "friction_law": "Coulomb and viscous friction, and what the effects below add",
            "base_parameters": round(contrast.determined),
            "torque_ratio_to_nominal": possible.torque_ratio,
            "sampling_skew": 0.0,
            "held_out": {
                "rmse": numbers(held_out),
                "torque_nrmse": numbers(held_out / rows.scale),
            },
            "inherent": [_plain(effect) for effect in comparison.effects()],
            "expected": self._expected(),
            "remainder": {"torque_nrmse": numbers(possible.lacking / rows.scale)},
            "today": {
                **_listed(comparison.sheet(CASE)),
                "torque_nrmse": numbers(np.sqrt((day**2).mean(axis=0))),
                "friction_allowed": FRICTION_DAY_TO_DAY,
            },
        }

    def _expected(self) -> list[dict[str, Any]]:
        """How large further effects would have to be for these recordings to show them."""
        return expected_entries(detectable(self._comparison.difference, CASE))

    def _sheet_deviations(self) -> dict[str, np.ndarray]:
        """Standard deviations of what was identified of the data sheet, (n,) each."""
        contrast = self._fit.contrast
        out: dict[str, np.ndarray] = {}
        variance = np.diag(contrast.covariance())
        for term, places in contrast.design.places.items():
            name = term.parametrisation.data_sheet
            if name is not None:
                std = np.sqrt(variance[places[0]]) / contrast.design.units[term][0]
                whole = out.setdefault(name, np.zeros(self._comparison.vendor.n_joints))
                whole[term.joint - 1] = std
        return out

    def _context(self) -> dict[str, Any]:
        """The arm, the recordings, how they were conditioned, and what was noticed."""
        comparison, prepared = self._comparison, self._comparison.prepared
        case, rows = prepared.case, comparison.rows
        inferred = WARNING in case.warnings
        every = (*case.recordings, *case.judged)
        notes = [f"{r.name}: {note}" for r in every for note in r.notes]
        warnings = [f"reference: {text}" for text in comparison.reference.warnings]
        changed = [known_effect(comparison.change(n).name) for n in comparison.named]
        if any(isinstance(effect, LinkChange) for effect in changed):
            warnings.append(SCALED)
        return {
            "arm": arm_entry(comparison.vendor),
            "nominal": {"friction": nominal_friction(comparison.possible_arm.arm)},
            "presliding": comparison.vendor.presliding.tolist(),
            "recordings": [
                *(recording_entry(r, "fit") for r in case.recordings),
                *(recording_entry(r, "judge") for r in case.judged),
            ],
            "conditioning": {
                "rate": rows.segments[0].motion.rate,
                "position_cutoff": prepared.position_cutoff,
                "torque_cutoff": TORQUE_CUTOFF,
                "how": "zero-phase Butterworth, order 4, on both sides; floor from noise and form error on motions of "
                "the reference that are predicted from others",
            },
            "judged_on": _judged_on(comparison, inferred),
            "torque_from": "controller" if inferred else "recorded",
            "warnings": [
                *case.warnings,
                *still_note(case),
                *short_note(case),
                *notes,
                *warnings,
            ],
            "considered": [],
        }


def _motion_rows(comparison: Comparison) -> MotionRows:
    """The rows on which the gap is measured, as what locates a gap takes them."""
    rows, mine = comparison.rows, comparison.explained.rows
    ddq = np.concatenate([rows.thin(s.motion.ddq, s) for s in rows.segments])
    numbers_of, segment = np.unique(rows.segment[mine], return_inverse=True)
    own = [rows.segments[k] for k in numbers_of]
    first = [rows.t[mine][segment == k][0] for k in range(len(own))]
    return MotionRows(
        t=rows.t[mine] - np.array(first)[segment],
        q=rows.position[mine],
        dq=rows.velocity[mine],
        ddq=ddq[mine],
        segment=segment,
        rates=tuple(s.motion.rate / rows.step(s) for s in own),
        names=tuple(s.recording for s in own),
        starts=tuple(float(t) for t in first),
    )


def _drawn(answer: Answer, rng: np.random.Generator) -> list[dict[Term, np.ndarray]]:
    """Coordinates of the terms of the case as likely as the data make them, (linear,) each."""
    if not answer.values:
        return []
    mean = np.concatenate(list(answer.values.values()))
    power, axes = np.linalg.eigh(answer.covariance)
    root = axes * np.sqrt(np.maximum(power, 0.0))
    draws = mean + rng.standard_normal((DRAWS, len(mean))) @ root.T
    ends = np.cumsum([len(value) for value in answer.values.values()])[:-1]
    out = []
    for draw in draws:
        parts = zip(answer.values, np.split(draw, ends), strict=True)
        out.append({one.term: x for one, x in parts if not one.everybody})
    return out


def _by_share(findings: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return sorted(findings, key=lambda finding: -finding["share"])


def _names(effect: str, probability: float, others: list[Alternative]) -> list[str]:
    """Names that hold the true one in nine of ten cases, in falling order."""
    names, total = [effect], probability
    for other in others:
        if total >= IN_TEN:
            break
        names.append(other.effect)
        total += other.probability
    return names


def _gap_entry(gap: GapStages) -> dict[str, Any]:
    return {
        "replayed": None,
        "engine": None,
        "before": {
            "torque_nrmse": numbers(gap.recorded),
            "replay_rmse": None,
            "replay_elsewhere": {},
            "floor": numbers(gap.floor),
        },
        "after": {
            "torque_nrmse": numbers(gap.corrected),
            "replay_rmse": None,
            "replay_elsewhere": {},
        },
    }


def _widest_first(gap: GapStages) -> list[int]:
    """Joints, from 1, whose gap is above the floor."""
    nrmse = gap.repaired
    return [int(j) + 1 for j in np.argsort(-nrmse) if nrmse[j] > gap.floor[j]]


def _judged_on(comparison: Comparison, inferred: bool) -> str:
    """On which data the gaps are measured, in words."""
    case = comparison.prepared.case
    text = "each motion, with the values fitted to the reference and to all others"
    if comparison.rows.set_aside.any():
        text = "recordings set aside for judging"
    elif len(case.recordings) > 1:
        text = (
            "each recording, with the values fitted to the reference and to all others"
        )
    if inferred:
        text += "; the torque there is the one that the known controller must have commanded"
    return text


def _listed(values: dict[str, np.ndarray]) -> dict[str, list[float]]:
    return {name: numbers(x) for name, x in values.items()}


def _plain(effect: Any) -> dict[str, Any]:
    values = {name: value.tolist() for name, value in effect.parameters.items()}
    return {"effect": effect.name, "joints": list(effect.joints), "parameters": values}


# What changed: the contrast of a case and a reference of the same arm; ``docs/contrast.md`` derives it.


def diagnose_change(
    case: Case,
    reference: KeptReference,
    folder: Path,
    progress: Callable[[str], None] = lambda message: None,
) -> Change:
    """Find what a case has that a reference does not have.

    Args:
        case: the case.
        reference: the same arm, when it was known to be healthy and without load.
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
        prepared = prepare(nominal, progress, case.arm, reference.faults)
        comparison = _compared(prepared, case, reference, progress)
        given = prepared.as_given(progress, reference.faults)
        # a fault that is news has to explain more than no fault and no change do
        if given is not None and _is_likelier(given, comparison, case, reference):
            progress("takes the recordings as they are: no fault explains more")
            prepared, comparison = given, _compared(given, case, reference, progress)
        # a computed torque may be explained better by another rule of the controller: then once more by that one
        changes = tuple(map(comparison.change, comparison.named))
        likelier = prepared.by_likelier_rule(changes, progress, reference.faults)
        if likelier is not None:
            comparison = _compared(likelier, case, reference, progress)
        progress("writes the findings")
        found = comparison.possible_arm
        (folder / URDF).write_bytes(found.urdf.encode())
        return Change(
            reference=reference,
            case=replace(comparison.prepared.case, arm=found.arm),
            effects=comparison.effects(comparison.named),
            remainder=found.remainder,
            comparison=comparison,
            diagnosis=diagnosis_of(comparison),
        )


def _compared(
    prepared: Prepared,
    case: Case,
    reference: KeptReference,
    progress: Callable[[str], None],
) -> Comparison:
    """The search for what the case has of its own."""
    progress("compares with the reference")
    found = _search(prepared, case, reference).run()
    return Comparison(reference, prepared, case.arm, found)


def _search(prepared: Prepared, case: Case, reference: KeptReference) -> Search:
    known = prepared.case
    rows = Rows.recorded([reference.recordings, known.recordings], known.judged)
    # what both share is free: the vendor's arm is as good a start as any
    arm = fitted_arm(rows, case.arm, {0})
    return Search(rows, arm, [(CASE,)], {0}, FRICTION_DAY_TO_DAY)


def _is_likelier(
    given: Prepared, comparison: Comparison, case: Case, reference: KeptReference
) -> bool:
    """Whether a case as it was given, without any change, is likelier than with what a comparison has found."""
    unchanged = _search(given, case, reference).unchanged()
    fault = comparison.faults_log_probability
    return unchanged > comparison.difference.fit.total + fault
