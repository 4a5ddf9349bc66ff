"""The diagnosis of a case: what its arm has that its data sheet does not say."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.arm.display import effect_name
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import rms
from gapscope.diagnosis.assessment.instrumental_values import instrumented
from gapscope.diagnosis.assessment.replay_gap import ReplayGap, replay_gap
from gapscope.diagnosis.assessment.sensor_sides import find_sides
from gapscope.diagnosis.assessment.unknown import Predictable, Unknown, unknown
from gapscope.diagnosis.document.content import (
    Document,
)
from gapscope.diagnosis.document.wording import another_scale, misread
from gapscope.diagnosis.prepare import Prepared, Progress, prepare, silent
from gapscope.diagnosis.result import Diagnosis
from gapscope.diagnosis.selection.search import (
    EVERYONE,
    WORSE,
    SheetSearch,
    nameable,
    search_of,
)
from gapscope.diagnosis.selection.undeclared_coupling import (
    UndeclaredCoupling,
    undeclared_coupling,
)
from gapscope.diagnosis.setup_faults.clocks import Quantisation
from gapscope.diagnosis.setup_faults.fault_search import common_factor
from gapscope.diagnosis.thresholds import (
    INERTIAL_ERROR,
    NO_TORQUE,
    PRESLIDING_GAIN,
    VISIBLE_EFFECT,
)
from gapscope.diagnosis.told_controller import ToldController
from gapscope.effects.applied import AppliedEffect, State
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import DryLaw, Turn
from gapscope.effects.environment import tilt
from gapscope.effects.friction import PRESLIDING_DISTANCES
from gapscope.model.conditioning import MIN_FLOOR, torque_scale
from gapscope.model.design import LIKELY
from gapscope.model.difference import Fit
from gapscope.model.explained import (
    Explained,
    HeldOut,
    beyond,
    explained,
    held_out,
    likely_errors,
)
from gapscope.model.readings import turn_of_base
from gapscope.model.rows import Rows
from gapscope.model.terms import Candidate, Term
from gapscope.model.torque_gap import gap_on_rows
from gapscope.model_audit.audit import odd_kinds

# What the recordings of a case show beside the data sheet of its arm.


@dataclass(frozen=True)
class SheetComparison(Document):
    """The contrast of a case with the data sheet of its arm, n joints.

    Attributes:
        searching: the search that found what the arm has.
        turn: the base as it is mounted, if that is far from what the case says: roll and pitch [rad]; of it the search
            found the rest.
    """

    floor_from: ClassVar[str] = "what a flexible model leaves of held-out motions"
    searching: SheetSearch
    turn: Mapping[Candidate, np.ndarray] = field(default_factory=dict)

    @property
    def case(self) -> Case:
        """The case as it was compared."""
        return self.prepared.case

    @cached_property
    def body(self) -> RigidBody:
        """Dynamics of the nominal arm."""
        return RigidBody(self.case.arm)

    @cached_property
    def fitted(self) -> Fit:
        """The hypothesis with values by least squares."""
        return self.searching.least_squares(self.fit)

    @property
    def sheet_error(self) -> float:
        """Likeliest error of the bodies of the data sheet, over their own size [1]."""
        return float(self.fitted.contrast.design.prior[0])

    @property
    def has_good_sheet(self) -> bool:
        """Whether the bodies are about what the data sheet says."""
        return self.sheet_error <= WORSE * INERTIAL_ERROR

    @cached_property
    def of_bodies(self) -> float:
        """Share of what stays that errors of the bodies explain, if the data sheet is a bad one [1]."""
        if self.has_good_sheet:
            return 0.0
        stays, beside = self.fitted.contrast.gap - self.fitted.torque, self.fitted.left
        nrmse = self.searching.torque_nrmse
        share = 1.0 - float(rms(nrmse(beside), None) / rms(nrmse(stays), None))
        return max(share, 0.0)

    @cached_property
    def named(self) -> tuple[str, ...]:
        """Findings that are more likely than not and close enough of held-out data to be seen."""
        # an arm cannot have what gives its bodies a negative energy
        names = tuple(name for name in self.likely if not self.feeds_energy(name))
        while names:
            known = self._explained(names)
            closed = {name: self._closed(known, name) for name in names}
            # one at a time: without it another may close more
            least = min(names, key=lambda name: closed[name])
            if closed[least] >= VISIBLE_EFFECT:
                break
            names = tuple(name for name in names if name != least)
        return names

    def feeds_energy(self, name: str) -> bool:
        """Whether bodies with a finding have a negative energy."""
        found = self.with_values(name, {**self.fitted.answer.values, **self.turn})
        return CorrectedArm(self.case.arm, (found,)).feeds_energy(self.body)

    @cached_property
    def unseen(self) -> dict[str, float]:
        """Findings that are likely, and close too little of held-out data, with the most that they close [1]."""
        known = self._explained(self.likely)
        unseen = [name for name in self.likely if name not in self.named]
        return {name: self._closed(known, name) for name in unseen}

    def _closed(self, known: Explained, name: str) -> float:
        """Most that a finding closes of a joint's held-out gap, and no more than of all joints together [1].

        Errors of the bodies are taken out or not: they may cover what it does, or do the same.
        """
        own = sum(known.torque[one] for one in self.findings[name])
        gaps = (known.after, known.after - known.errors)
        closed = [known.visible(left + own) - known.visible(left) for left in gaps]
        # what it opens on others counts against what it closes on one
        plain, beside = (float(min(some.max(), some.sum())) for some in closed)
        # what closes nothing by itself is no finding, whatever errors do beside it
        return max(plain, beside) if plain > 0 else plain

    @cached_property
    def explained(self) -> Explained:
        """What the findings that are named explain, each part predicted from all others."""
        return self._explained(self.named)

    @cached_property
    def judged_on(self) -> Rows:
        """Rows of what is set aside, over the same scale as all others; without any those that are fitted."""
        if not self.set_aside:
            return self.rows
        rows = Rows.recorded([self.set_aside])
        rows.scale = self.rows.scale
        return rows

    def _on_set_aside(self, names: Collection[str]) -> Explained:
        """What some findings explain of recordings that are judged, with values fitted to all others."""
        rows, arm = self.judged_on, self.case.arm
        found = self.values_of(names)
        effects = {n: self.with_values(n, {**found, **self.turn}) for n in names}

        # by the laws themselves: nothing is linearised where nothing was fitted
        def left(some: Collection[str]) -> np.ndarray:
            arm_with = CorrectedArm(arm, tuple(effects[name] for name in some))
            return self._gap_on(rows, arm_with)

        after = left(names)
        torque = {one: np.zeros_like(after) for one in found}
        for name in names:
            without = left([other for other in names if other != name])
            # all joints together, at the first candidate: the others stay at zero
            torque[self.findings[name][0]] = without - after
        # what a healthy arm has is told by what was fitted
        shared = likely_errors(self.fit, found, self.group)
        made, fitted = self.searching.design_on(rows), self.fit.contrast.design
        there = np.zeros(made.size)
        # ten parameters of each link come first in every design, in the same order
        bodies = 10 * arm.n_joints
        there[:bodies] = shared[:bodies]
        for term, places in made.places.items():
            if term in fitted.places:
                there[places] = shared[fitted.places[term]]
        errors = rows.in_newton_metres(made.shared_torque(there))
        scale = torque_scale(rows.torque)
        every = np.ones(len(after), dtype=bool)
        floor = np.zeros(len(scale))
        hidden = rows.hides * rows.scale
        return Explained(every, after, torque, errors, floor, scale, rows.trust, hidden)

    def _gap_on(self, rows: Rows, arm: CorrectedArm) -> np.ndarray:
        """Gap of an arm [N m], (M, n); what no torque was measured of has no weight."""
        return gap_on_rows(rows, arm, self.body) * rows.measured

    def torque_of(self, one: Candidate) -> np.ndarray:
        """What a candidate does to the torque, as it was fitted to all [N m], (M, n)."""
        if not self.set_aside:
            return super().torque_of(one)
        name = one.term.finding
        if one != self.findings[name][0]:
            # on what is set aside all joints of a finding are one
            return np.zeros_like(self.explained.after)
        found = self.with_values(name, self.fitted.answer.values)
        arm = CorrectedArm(self.case.arm, (found,))
        both = (self._gap_on(self.judged_on, a) for a in (self.nominal, arm))
        return np.subtract(*both)

    @cached_property
    def _known(self) -> dict[tuple[str, ...], Explained]:
        """What sets of findings explain, those that were asked for."""
        return {}

    def _explained(self, names: tuple[str, ...]) -> Explained:
        if names not in self._known:
            self._known[names] = self._held_out(names)
        return self._known[names]

    def _held_out(self, names: tuple[str, ...]) -> Explained:
        if self.set_aside:
            return self._on_set_aside(names)
        known = explained(self.fit, self.group, self.of(names), self.fitted)
        if not self.turn:
            return known
        # the search is about the arm as it is mounted
        nominal = self._gap_on(self.rows, self.nominal)
        mounted = self.rows.in_newton_metres(self.fit.contrast.design.gap)
        turned = (nominal - mounted)[known.rows]
        more = {one: known.torque.get(one, 0.0) + turned for one in self.turn}
        return replace(known, torque={**known.torque, **more})

    @cached_property
    def values(self) -> Mapping[Candidate, np.ndarray]:
        """Values of what is named."""
        return {**self.values_of(self.named), **self.turn}

    @cached_property
    def effects(self) -> tuple[AppliedEffect, ...]:
        """What is named, with values fitted to all recordings that may be fitted."""
        return tuple(self.change(name) for name in self.named)

    def effects_without(self, part: HeldOut) -> dict[str, AppliedEffect]:
        """What is named, with values that were not fitted to a part of the recordings."""
        values = {**part.answer.values, **self.turn}
        return {name: self.with_values(name, values) for name in self.named}

    @cached_property
    def nominal(self) -> CorrectedArm:
        """The arm of the data sheet."""
        return CorrectedArm(self.case.arm)

    @cached_property
    def corrected(self) -> CorrectedArm:
        """The same with what is named."""
        arm = replace(self.case.arm, presliding=self.presliding)
        return CorrectedArm(arm, self.effects)

    @cached_property
    def presliding(self) -> np.ndarray:
        """Distance over which the dry friction that is named builds up [rad], (n,); 0 where none narrows the gap.

        It is no cause of a gap but part of how dry friction acts: sgn v says nothing of a joint that rests or turns
        round slowly, where most of what dry friction leaves lies. It comes from a grid, with the values as fitted. It
        has to narrow the gap of all rows, and those decide that are trusted: a distance that suits rests alone does
        harm on motions without any.
        """
        arm, rows = self.case.arm, self.rows
        # joints with dry friction of their own
        dry = np.zeros(arm.n_joints, dtype=bool)
        for term in (t for name in self.named for t in self._terms(name)):
            if isinstance(term.definition, DryLaw) and term.definition.reach == "joint":
                dry[term.joint - 1] = True
        if not dry.any():
            return np.zeros(arm.n_joints)
        # a slide counts metres; zero, the law as it is, comes first
        distances = [
            np.where(dry, d * arm.per_radian, 0.0) for d in (0.0, *PRESLIDING_DISTANCES)
        ]
        every, trusted = [], []
        for distance in distances:
            bent = CorrectedArm(replace(arm, presliding=distance), self.effects)
            gap = gap_on_rows(rows, bent, self.body)
            every.append(((gap * rows.measured) ** 2).sum(axis=0))
            trusted.append(((gap * rows.trust) ** 2).sum(axis=0))
        # what widens the gap of all rows is out, whatever trusted ones say
        wider = np.array(every) > every[0]
        squares = np.where(wider, np.inf, trusted)
        # log likelihood ratio of noise of fitted variance: N / 2 ln(S0 / S)
        gain = self.samples / 2 * np.log(squares[0] / squares.min(axis=0))
        best = np.array(distances)[np.argmin(squares, axis=0), np.arange(len(dry))]
        return np.where(gain > PRESLIDING_GAIN, best, 0.0)

    def _terms(self, name: str) -> list[Term]:
        return [one.term for one in self.findings[name]]

    @property
    def samples(self) -> np.ndarray:
        """Independent samples of each joint, (n,)."""
        error = self.fit.contrast.error
        # neighbours in time count once: white over whole variance
        count = (self.rows.trust**2).sum(axis=0)
        return np.asarray(count * error.white2 / error.noise2)

    # What a healthy arm would leave, and what is left beyond it.

    @cached_property
    def unknown(self) -> Unknown:
        """What is left and comes again with the motion, beside likely errors of a healthy arm.

        Errors larger than two deviations beyond a good data sheet's explain what those of that size would.
        """
        # bodies that are off by more would explain away what is unknown
        known, largest = self.explained, WORSE**2 * INERTIAL_ERROR
        share = largest / max(self.sheet_error, largest)
        left = known.after - share * known.errors
        gap = self.gap(beyond(left, known.hidden))
        white2 = self.fit.contrast.error.white2.copy()
        for found in self.prepared.faults:
            # the rounding of an encoder leaves noise of any size
            if isinstance(found.fault, Quantisation):
                white2[np.array(found.fault.joints) - 1] = np.inf
        return unknown(gap, self.motion_rows, known.trust, known.scale, white2)

    @cached_property
    def floor(self) -> np.ndarray:
        """RMS of what is left that has no unknown cause: noise, and errors of a healthy arm [N m], (n,)."""
        # what is left less its unknown part, by squares
        left2 = (self.explained.after**2).mean(axis=0)
        known2 = left2 * (1.0 - self.unknown.share)
        return np.sqrt(np.maximum(known2, MIN_FLOOR**2))

    # Its replay in the simulator, and its joint torque sensors.

    @cached_property
    def replayed(self) -> ReplayGap:
        """Replay gap before and after, on a recording to which values were not fitted."""
        if self.set_aside:
            # no value was fitted to what is set aside: all that is named stays as it is
            named = {name: self.change(name) for name in self.named}
            return replay_gap(self.case, self.set_aside[0], named)
        recording, part = self._last_part()
        return replay_gap(self.case, recording, self.effects_without(part))

    def _last_part(self) -> tuple[Recording, HeldOut]:
        """The liveliest recording, or the last part of a single one."""
        # parts come from the calmest recording on, and of each in the order of time
        *_, part = held_out(self.fitted, self.group, self.of(self.named))
        fitted = [r for r in self.case.recordings if r.tau is not None]
        last = self.rows.segments[self.rows.segment[part.rows][-1]].recording
        recording = next(r for r in fitted if r.name == last)
        # of several recordings each held-out part is a whole one
        if len({s.recording for s in self.rows.segments}) > 1:
            return recording, part
        t = self.rows.t[part.rows]
        inside = (recording.t >= t.min()) & (recording.t <= t.max())
        return recording.part(inside), part

    @cached_property
    def coupling(self) -> UndeclaredCoupling | None:
        """Two joints that seem to be turned by one motor of which the case says nothing."""
        return undeclared_coupling(self.searching, self.fit, self.unknown.joints)

    @cached_property
    def by_commands(self) -> Mapping[str, AppliedEffect]:
        """Findings with values by the commands as instruments; none if the commands are not known."""
        if self.case.controller is None or self.turn:
            return {}
        fitted = [r for r in self.case.recordings if r.tau is not None]
        # beside the values found, not in their place
        values = instrumented(self.searching, self.fitted, fitted)
        return {
            name: self.with_values(name, values)
            for name, mine in self.findings.items()
            if all(one in values for one in mine)
        }

    def parameters(self, name: str) -> dict[str, dict[str, object]]:
        """Values with their standard deviations, and those by the commands of what acts linearly."""
        out, by_commands = super().parameters(name), self.by_commands.get(name)
        if by_commands is None:
            return out
        nonlinear = self._terms(name)[0].parametrisation.nonlinear
        for parameter in by_commands.given:
            # searched parameters and link numbers are no coordinates
            if parameter not in (*nonlinear, "link"):
                out[parameter]["by_commands"] = by_commands.parameters[parameter]
        return out

    @property
    def told(self) -> ToldController | None:
        """The controller, if its references told it, beside all that was found."""
        told = self.prepared.told
        if told is None or told.law.feedforward != "none":
            return told
        share, std = self.searching.scales(self.fit)
        # farther off the recordings lack something else
        likely = np.abs(share) < LIKELY * told.unsure
        return told.scaled(share, std) if likely.all() else told

    @cached_property
    def states(self) -> tuple[State, ...]:
        """All effects in each recording and span; none if all share a state."""
        return self.prepared.states.effects(self.terms, self.own_theta)

    # What its document says in its own way.

    @property
    def unknown_joints(self) -> list[int]:
        """Joints on which there is an unknown cause, from 1."""
        return self.unknown.joints

    @property
    def predictable(self) -> list[Predictable]:
        """What can be predicted of the gap that is left, of each joint."""
        return self.unknown.predictable

    def doubt(self, reached: str) -> tuple[str, str]:
        """What makes the nominal arm another one than was recorded, and what to do first; empty if nothing does."""
        if reached != "unexplained":
            return "", ""
        off, another = rms(self.stages.repaired, None), self.prepared.another_arm
        given = self.case.arm.gravity
        shown = self.searching.arm.arm.gravity if self.turn else given
        said = misread(float(off), shown, given, another=another)
        # as a check says it of the same case
        factor = None if any(said) else common_factor(self.case)
        if factor is not None:
            return another_scale(*factor)
        # first, if it is most of what stays
        return said if any(said) or self.of_bodies < 0.5 else self.bad_sheet()

    def bad_sheet(self) -> tuple[str, str]:
        """That the bodies of the robot file are far off, and what to do."""
        return (
            f"the bodies of the robot file seem to be off by about {self.sheet_error:.0%} of their size, which would "
            f"explain {self.of_bodies:.0%} of what stays and hides loads and changed links",
            "identify the bodies (gapscope identify), or compare with a reference (diagnose --against)",
        )

    def further(self) -> dict[str, Any]:
        """What further effects would have to be to show, sides of the sensors, and a controller that was told."""
        out: dict[str, Any] = {}
        # of another arm than the nominal one no size is known
        another = self.prepared.another_arm
        out["expected"] = [] if another else nameable(self.difference)
        fitted = [r for r in self.case.recordings if r.tau is not None]
        used = self.set_aside or fitted
        sides = find_sides(self.nominal, self.corrected, self.body, used)
        if sides is not None:
            out["sides"] = sides
        if self.told is not None:
            out["controller"] = self.told.entry()
        return out

    def _context(self, reached: str) -> dict[str, Any]:
        out = super()._context(reached)
        out["conditioning"]["nominal_inertials_std"] = self.sheet_error
        return out

    def warnings(self, reached: str) -> list[str]:
        """What was noticed of the replay, of a controller that was told and of the robot file."""
        out = list(self.replayed.warnings)
        out += [] if self.told is None else self.told.sentences()
        file = self.case.arm.urdf
        odd = odd_kinds(file) if reached == "unexplained" else ""
        if odd:
            # what is wrong in the file need not be looked for in the recordings
            where = f"see gapscope audit {file.resolve()}"
            out.insert(0, f"in the robot file: {odd}; {where}")
        if reached != "no_gap" and not self.has_good_sheet:
            out.append("; ".join(self.bad_sheet()))
        return out

    def considered(self) -> list[dict[str, Any]]:
        """Findings that close too little, and what was weighed beside what was found, each in its likeliest set."""
        out = []
        for name, closed in self.unseen.items():
            reason = (
                "bodies with it would have a negative energy"
                if self.feeds_energy(name)
                else "it closes too little of the gap of unseen data for a person to see"
            )
            out.append(_considered(self._terms(name), None, closed, reason))
        return [*out, *self._runners_up()]

    def _runners_up(self) -> Iterator[dict[str, Any]]:
        seen: set[str] = set()
        fit, sets = self.fit, self.difference.sets
        mine = frozenset(fit.mine)
        here = sets.get(mine, 0.0)
        # the likeliest sets first: each effect is told once, where it does best
        for some, value in sorted(sets.items(), key=lambda e: -e[1]):
            more, less = some - mine, mine - some
            names = {one.effect for one in more}
            places = {one.term.finding for one in less}
            # only what differs by one more effect, and one finding less, has one reason
            if len(names) != 1 or names & seen or len(places) > 1:
                continue
            seen |= names
            if places:
                reason = f"{effect_name(next(iter(less)).effect)} explains more"
            elif value > here:
                reason = "it closes too little of the gap for a person to see"
            else:
                reason = "what it explains is not worth one more effect"
            kept = [one for one in fit.mine if one in some]
            values = fit.own.answer([*kept, *more]).values
            gaps = (fit.torque, fit.own.torque(values))
            # how much more of each joint's gap it would close
            closed = np.subtract(
                *(self.searching.torque_nrmse(fit.contrast.gap - x) for x in gaps)
            )
            terms = [one.term for one in more]
            yield _considered(terms, value - here, float(closed.sum()), reason)


def _considered(
    terms: list[Term], evidence: float | None, closed: float, reason: str
) -> dict[str, Any]:
    on_joints = [t.joint for t in terms if t.definition.scope == "joint"]
    return {
        "effect": terms[0].effect,
        "joints": sorted(on_joints),
        "log_evidence": evidence,
        "gap_closed": closed,
        "reason": reason,
    }


# The diagnosis.


def diagnose(case: Case, progress: Progress = silent) -> Diagnosis:
    """Find where the gap of a case lies, which effects cause it, and how far it shrinks with them.

    Args:
        case: the nominal arm and its recordings.
        progress: called with a few words at each step.

    Raises:
        GapscopeError: no recording carries a torque that can be trusted, nor is there a known controller with its
            reference that determines it.
        InputError: a recording has no stretch without gaps that is long enough.
    """
    # Many small matrices: threads would only wait for each other.
    with threadpool_limits(1):
        return examine(case, progress).diagnosis(progress)


def examine(case: Case, progress: Progress = silent) -> SheetComparison:
    """Compare a case with its data sheet; arguments and errors are those of ``diagnose``."""
    prepared = prepare(case, progress)
    found = _compared(prepared, progress)
    # a computed torque may follow another rule, beside what was found
    likelier = prepared.by_likelier_rule(found.effects, progress)
    if likelier is not None:
        prepared, found = likelier, _compared(likelier, progress)
    left = found.explained.visible(found.explained.after)
    # effects speak for the nominal arm only if its bodies are about right
    explained = found.has_good_sheet and found.reached == "effects_found"
    # worse than no torque at all with all that was found, or not explained by that
    if rms(left, None) > NO_TORQUE or (prepared.doubted and not explained):
        return _compared(prepared.of_another_arm(), progress)
    return found


def _compared(prepared: Prepared, progress: Progress) -> SheetComparison:
    """The search for what the arm has; of another arm than the nominal one nothing is looked for."""
    case = prepared.case
    fitted = [r for r in case.recordings if r.tau is not None]
    unsure = None if prepared.told is None else prepared.told.unsure
    searching = search_of(case.arm, fitted, unsure)
    if prepared.another_arm:
        found = searching.unsearched()
        return SheetComparison(prepared, found, *EVERYONE, searching)
    progress("searches for effects")
    searching.progress = progress
    found = searching.run()
    # a base turned far is found before the search, and is named with what it found
    turn = turn_of_base(case.arm.gravity, searching.arm.arm.gravity)
    if turn is None:
        return SheetComparison(prepared, found, *EVERYONE, searching)
    # the turn joins the set that was found, whether a rest of it pays or not
    places = found.fit.contrast.design.places
    tilts = [Candidate(t, EVERYONE) for t in places if isinstance(t.definition, Turn)]
    found = searching.with_also(found, tilts)
    # what is left of a turn about the base as it seems to be mounted
    rest = np.concatenate([found.fit.answer.values[one] for one in tilts])
    gravity = tilt(*rest).T @ searching.arm.arm.gravity
    whole = np.array(turn_of_base(case.arm.gravity, gravity) or turn)
    turned = dict.fromkeys(tilts, whole)
    return SheetComparison(prepared, found, *EVERYONE, searching, turned)
