"""A comparison as a document, ``diagnosis.json``, and as the diagnosis with the curves that a report draws."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from gapscope.arm.io.json_file import plain
from gapscope.arm.nominal import NominalArm, arm_entry
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import SMALLEST, rms
from gapscope.diagnosis.agreement import states
from gapscope.diagnosis.assessment.replay_gap import ReplayGap
from gapscope.diagnosis.assessment.unknown import Predictable
from gapscope.diagnosis.comparison import Comparison, names_of
from gapscope.diagnosis.document.findings import (
    LISTED_ALTERNATIVE,
    GapStages,
    alternative_entry,
    at_middle_entry,
    gravity_entry,
    region_entry,
    settled_by,
    share_entry,
    suggested_recording,
    with_faults,
    with_states,
    with_torques_turned,
)
from gapscope.diagnosis.document.plotted_curves import (
    located,
    signatures,
    spectrum,
    traces,
)
from gapscope.diagnosis.document.wording import Verdict, with_slide_units
from gapscope.diagnosis.gap.commanded_torque import WARNING
from gapscope.diagnosis.gap.plausible_data import short_note, still_note
from gapscope.diagnosis.gap.repeatability import repeatability
from gapscope.diagnosis.locate import MotionRows, regions, stacked
from gapscope.diagnosis.locate import located as regions_of
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.diagnosis.result import Diagnosis
from gapscope.diagnosis.selection.undeclared_coupling import UndeclaredCoupling
from gapscope.diagnosis.thresholds import FALSE_DISCOVERY_RATE, UNKNOWN_TORQUE
from gapscope.effects.applied import AppliedEffect, State
from gapscope.effects.effect import External
from gapscope.model.changes import Change, change_findings
from gapscope.model.conditioning import TORQUE_CUTOFF, WORKING_RATE, every_so_many
from gapscope.model.torque_gap import TorqueGap


def recording_entry(recording: Recording, role: str) -> dict[str, Any]:
    """A recording, and whether effects are fitted to it or judged on it."""
    entry = {
        "name": recording.name,
        "duration": recording.duration,
        "rate": recording.rate,
        "role": role,
    }
    if recording.payload is not None:
        entry["payload"] = recording.payload.entry()
    return entry


@dataclass(frozen=True)
class Document(Comparison):
    """A comparison that is written; what a comparison with something says beside, it says in its own way."""

    floor_from: ClassVar[str]
    """Where the floor comes from, in words."""
    fitted_to: ClassVar[str] = ""
    """What values are fitted to beside the case, in words."""

    # What a comparison says in its own way.

    @property
    def declared(self) -> NominalArm:
        """The nominal arm as it was declared."""
        return self.prepared.case.arm

    @property
    def compared_with(self) -> NominalArm:
        """The arm that the case is compared with, with its data sheet."""
        return self.prepared.case.arm

    @property
    def unknown_joints(self) -> list[int]:
        """Joints on which there is an unknown cause, from 1."""
        raise NotImplementedError

    @property
    def states(self) -> tuple[State, ...]:
        """All effects in each recording and span; none if all share a state."""
        raise NotImplementedError

    @property
    def floor(self) -> np.ndarray:
        """RMS that a healthy arm leaves [N m], (n,)."""
        return self.explained.floor

    @property
    def presliding(self) -> np.ndarray:
        """Distance over which dry friction builds up [rad], (n,)."""
        return self.declared.presliding

    @property
    def replayed(self) -> ReplayGap:
        """The replay gap before and after, if the case was replayed."""
        return ReplayGap()

    @property
    def predictable(self) -> list[Predictable]:
        """What can be predicted of the gap that is left, of each joint."""
        return []

    @property
    def coupling(self) -> UndeclaredCoupling | None:
        """Two joints that seem to be turned by one motor of which the case says nothing."""
        return None

    def doubt(self, reached: str) -> tuple[str, str]:
        """What makes the nominal arm another one than was recorded, and what to do first; empty if nothing does."""
        return "", ""

    def further(self) -> dict[str, Any]:
        """Further entries of the document."""
        return {}

    def warnings(self, reached: str) -> list[str]:
        """What was noticed beside what all notice."""
        return []

    def considered(self) -> list[dict[str, Any]]:
        """Effects that the search weighed and did not name."""
        return []

    # Gaps.

    @cached_property
    def motion_rows(self) -> MotionRows:
        """The rows on which the gap is measured, as what locates a gap takes them."""
        return stacked(self.judged_on, self.explained.rows)

    def gap(self, error: np.ndarray) -> TorqueGap:
        """A gap on the rows that are judged, (M, n), as that of an arm."""
        measured = self.judged_on.torque[self.explained.rows]
        return TorqueGap(measured, measured - error)

    @cached_property
    def gaps(self) -> dict[str, TorqueGap]:
        """Gap before and after what is named, each motion predicted from all others."""
        known = self.explained
        return {"before": self.gap(known.before), "after": self.gap(known.after)}

    @cached_property
    def stages(self) -> GapStages:
        """The gap at the stages of the diagnosis."""
        known, faults = self.explained, self.prepared.faults
        repaired = known.nrmse(known.before)
        # the gap with all faults in it; without faults nothing was put right
        recorded = [f.gap_before for f in faults if f.gap_before is not None]
        return GapStages(
            recorded=recorded[0] if recorded else repaired,
            repaired=repaired,
            corrected=known.nrmse(known.after),
            floor=self.floor / known.scale,
        )

    @property
    def times_floor(self) -> np.ndarray:
        """What is left over the floor, (n,)."""
        return np.asarray(self.stages.corrected / self.stages.floor)

    def knows_most(self) -> bool:
        """Whether what is named closes more than what is unknown leaves: of the gap, and of each joint's square."""
        gap = self.stages
        # a repaired fault closes all that it took away
        before = np.maximum(gap.recorded, gap.repaired)
        unknown = np.isin(np.arange(len(before)) + 1, self.unknown_joints)
        floor = np.where(unknown, gap.floor, gap.corrected)

        def balance(power: int) -> np.ndarray:
            """What is closed less what stays open, neither below zero, of each joint."""
            first, last, least = before**power, gap.corrected**power, floor**power
            return np.asarray((first - last).clip(0) - (last - least).clip(0))

        return bool(balance(1).sum() >= 0 and (balance(2) >= 0).all())

    # The document.

    def content(self) -> dict[str, Any]:
        """The whole document."""
        prepared, gap = self.prepared, self.stages
        joints = self.unknown_joints
        found, possible = (
            sorted(map(self._finding, names), key=lambda finding: -finding["share"])
            for names in (self.named, self.possible)
        )
        n_joints = self.declared.n_joints
        found = [with_torques_turned(finding, n_joints) for finding in found]
        here = with_faults(found, prepared.faults, gap)
        # after the shares are one whole: another state has a gap of its own
        effects = with_states(here, prepared.states, self.terms, self.own_theta)
        possible = [{**f, "settled_by": settled_by(f)} for f in possible]
        reached = self.reached
        # where the arm was compared nothing need have changed
        unchanged = reached != self._verdict(found=bool(here))
        closed = None if unchanged else gap.closed
        # what stays on a joint is worth a recording only where the verdict says that it is unexplained
        unexplained = joints if reached == "unexplained" else []
        doubt, first = self.doubt(reached)
        shared = prepared.states.found
        coupling = self.coupling
        content = {
            "schema": 1,
            "case": prepared.case.name,
            "verdict": reached,
            # of another arm this is all that is said; else it is a warning, below
            **({"misread": doubt} if prepared.another_arm else {}),
            "gap": self._gap(),
            "effects": effects,
            "possible": possible,
            "changes": change_findings(self._changes),
            **({} if shared is None else {"states": states(shared)}),
            "closed": closed,
            "unexplained": {
                "share": 0.0 if closed is None else 1.0 - closed,
                "above_floor": bool(unexplained),
                "joints": joints,
                "times_floor": self.times_floor,
                "where": self._where("after", joints),
                "predictable": [
                    p.document() for p in self.predictable if p.joint in joints
                ],
                "coupling": coupling and coupling.entry(),
            },
            "next_recording": suggested_recording(
                reached, effects, possible, unexplained, coupling, first
            ),
            "where": self._where("before", self._widest_first()),
            **self.further(),
        }
        content |= self._context(reached)
        if first and not prepared.another_arm:
            said = f"{doubt}; {first}"
            others = [warning for warning in content["warnings"] if warning != said]
            content["warnings"] = [said, *others]
        return with_slide_units(plain(content), self.declared.sliding)

    def diagnosis(self, progress: Progress = silent) -> Diagnosis:
        """The diagnosis: its findings, and the curves that a report draws."""
        progress("replays a recording in the simulator")
        content = self.content()
        progress("writes the findings")
        gaps, rows = self.gaps, self.motion_rows

        def effects(names: tuple[str, ...], section: str) -> tuple[AppliedEffect, ...]:
            # faults of the set-up are among the findings, too, but are no part of the corrected arm
            order = [finding["effect"] for finding in content[section]]
            every = map(self.change, names)
            return tuple(sorted(every, key=lambda effect: order.index(effect.name)))

        named = [(self.change(name), self._own_torque(name)) for name in self.named]
        return Diagnosis(
            document=content,
            effects=effects(self.named, "effects"),
            traces=traces(gaps, rows),
            signatures=signatures(named, gaps["after"], rows, self.declared.sliding),
            spectrum=spectrum(gaps, rows),
            located=located(content, gaps, self.floor, rows),
            possible=effects(self.possible, "possible"),
            presliding=tuple(self.presliding.tolist()),
            faults=self.prepared.faults,
            arm=self.compared_with,
            replayed=self.replayed.motion,
            states=self.states,
            case_file=self.prepared.case.file,
        )

    @cached_property
    def _changes(self) -> list[Change]:
        """Changes during recordings, but those of a force from outside at a time at which an effect has one."""
        out = list(self.prepared.changes)
        for name in self.named:
            applied = self.change(name)
            if not isinstance(applied.effect, External):
                continue
            times = self.findings[name][0].term.parametrisation.nonlinear
            start, end = (float(applied.parameters[time]) for time in times)
            out = [
                change
                for change in out
                if not isinstance(change.term.definition, External)
                or change.interval[1] < start
                or change.interval[0] > end
            ]
        return out

    @cached_property
    def reached(self) -> Verdict:
        """The verdict."""
        # a fault or a change is a cause as well as an effect
        found = self.named or self.prepared.faults or self._changes
        # another state of recordings is one if something of it can be seen
        elsewhere = with_states([], self.prepared.states, self.terms, self.own_theta)
        return self._verdict(found=bool(found or elsewhere))

    def _verdict(self, *, found: bool) -> Verdict:
        # what is not named may leave more of the gap open than what is closes
        if self.prepared.another_arm or not self.knows_most():
            return "unexplained"
        return "effects_found" if found else "no_gap"

    def _gap(self) -> dict[str, Any]:
        """The gap before and after, torque and replay, and what the arm's own repeats differ by."""
        gap, replay, rows = self.stages, self.replayed, self.motion_rows
        after = self.gaps["after"]
        found = repeatability(after, rows.edges, rows.rates, self.floor)
        repeated = None
        if found is not None:
            nrmse = found.rms / self.explained.scale
            repeated = {
                "torque_nrmse": nrmse,
                "seconds": found.seconds,
                "times": float(rms(after.nrmse) / rms(nrmse)),
            }
        before, after_all = (
            {
                "torque_nrmse": nrmse,
                "replay_rmse": replayed,
                "replay_elsewhere": {
                    engine: gaps[stage] for engine, gaps in replay.elsewhere.items()
                },
            }
            for stage, (nrmse, replayed) in enumerate(
                ((gap.recorded, replay.before), (gap.corrected, replay.after))
            )
        )
        return {
            "replayed": replay.by,
            "engine": replay.engine,
            "repeatability": repeated,
            "before": {**before, "floor": gap.floor},
            "after": after_all,
        }

    def _finding(self, name: str) -> dict[str, Any]:
        """Evidence, values, gaps and places of a finding."""
        known, replay = self.explained, self.replayed
        applied, own = self.change(name), self._own_torque(name)
        # the gap after holds what is named: it is put back to see the gap without it
        in_model = name in self.named
        only = known.before - own
        without = known.after + own if in_model else known.after
        # what is only possible is judged as if it were there as well
        left = known.after if in_model else known.after - own
        probability = self.probabilities[name]
        alternatives = self.alternatives(name)
        # what it closes of the square in each row
        closed = np.sqrt(np.clip(without**2 - left**2, 0.0, None))
        closed_first, closed_last = (
            float((known.nrmse(more) - known.nrmse(less)).sum())
            for more, less in ((known.before, only), (without, left))
        )
        # an effect without joints is shown where it closes most
        most = np.argsort(-(closed**2).sum(axis=0))[:2] + 1
        joints = list(applied.joints) or most.tolist()
        load = self.gaps["before"].predicted
        # one region for each joint: where this finding acts most
        places = regions(closed, self.motion_rows, load, joints, most=1)
        gaps = {
            key: {
                "torque_nrmse": known.nrmse(gap),
                "replay_rmse": replayed.get(name),
            }
            for key, gap, replayed in (
                ("gap_with_only_this", only, replay.only),
                ("gap_without_this", without, replay.without),
            )
        }
        return {
            "effect": applied.name,
            "joints": applied.joints,
            "probability": probability,
            "set": names_of(applied.name, probability, alternatives),
            "support": self.support(name),
            **gaps,
            "where": [region_entry(region) for region in places],
            "alternatives": [
                alternative_entry(applied.name, other)
                for other in alternatives
                if other.probability > LISTED_ALTERNATIVE
            ],
            "carried_by": self._carried_by(closed),
            "parameters": self.parameters(name),
            **share_entry(closed_first, closed_last, self.stages.whole),
            **self._significance(name),
            **gravity_entry(applied, self.prepared.case.arm),
            **at_middle_entry(applied, self.motion_rows.q),
        }

    def _own_torque(self, name: str) -> np.ndarray:
        """What a finding does to the torque [N m], (M, n); of one that is not named, as it was fitted to all."""
        torque = self.explained.torque
        return np.asarray(
            sum(
                torque[one] if one in torque else self.torque_of(one)
                for one in self.findings[name]
            )
        )

    def _significance(self, name: str) -> dict[str, Any]:
        """Evidence for a finding, and the share of false ones among those as sure."""
        probabilities = self.probabilities
        as_sure = [
            1.0 - probabilities[other]
            for other in self.findings
            if probabilities[other] >= probabilities[name]
        ]
        rate = float(np.mean(as_sure))
        return {
            "log_e": self.log_odds(name),
            "false_discovery_rate": rate,
            "confirmed": rate <= FALSE_DISCOVERY_RATE,
        }

    def _carried_by(self, closed: np.ndarray) -> dict[str, Any]:
        """Shares of the squares that a finding closes, over the noise: by joint, and by recording."""
        # noise is over the scale of the torque: back to (N m)^2
        noise2 = self.fit.contrast.error.noise2 * self.rows.scale**2
        nats = closed**2 / noise2
        total = max(float(nats.sum()), SMALLEST)
        segments = self.motion_rows.segment
        recordings: dict[str, float] = {}
        for k, name in enumerate(self.motion_rows.names):
            share = float(nats[segments == k].sum()) / total
            # segments of one recording add up, rounding not beyond one
            recordings[name] = min(recordings.get(name, 0.0) + share, 1.0)
        return {
            "joints": nats.sum(axis=0) / total,
            "recordings": recordings,
        }

    def _where(self, stage: str, joints: list[int]) -> list[dict[str, Any]]:
        """Regions in which the gap ``before`` or ``after`` the findings is concentrated."""
        error, load = self.gaps[stage].error, self.gaps["before"].predicted
        places = regions_of(error, self.motion_rows, load, self.floor, joints)
        return [region_entry(region) for region in places]

    def _widest_first(self) -> list[int]:
        """Joints, from 1, whose gap is above the floor by what is worth a search."""
        nrmse, floor = self.stages.repaired, self.stages.floor
        # squares of independent parts add up
        above = nrmse**2 > floor**2 + UNKNOWN_TORQUE**2
        return [int(j) + 1 for j in np.argsort(-nrmse) if above[j]]

    def _context(self, reached: str) -> dict[str, Any]:
        """The arm, the recordings, how they were conditioned, and what was noticed."""
        # the warning is how a case says that its torque was worked out
        prepared, case, arm = self.prepared, self.prepared.case, self.compared_with
        inferred = prepared.told is not None or WARNING in case.warnings
        every = (*case.recordings, *case.judged)
        (rate, *_) = (r.rate for r in every if r.name == self.motion_rows.names[0])
        judged_on = f"each motion, with the values fitted to {self.fitted_to}all others"
        if self.set_aside:
            judged_on = "recordings set aside for judging"
        if inferred:
            judged_on += (
                "; the torque there is the one that the controller must have commanded"
            )
        return {
            "arm": arm_entry(self.declared),
            "nominal": {
                "friction": {
                    "source": arm.friction_source or None,
                    "coulomb": arm.coulomb,
                    "viscous": arm.viscous,
                }
            },
            "presliding": self.presliding,
            "recordings": [
                *(recording_entry(r, "fit") for r in case.recordings),
                *(recording_entry(r, "judge") for r in case.judged),
            ],
            "conditioning": {
                "rate": rate / every_so_many(rate, WORKING_RATE),
                "position_cutoff": prepared.position_cutoff,
                "torque_cutoff": TORQUE_CUTOFF,
                "how": "zero-phase Butterworth, order 4, on both sides; positions cut where their spectrum meets its "
                f"noise; floor from {self.floor_from}",
            },
            "judged_on": judged_on,
            "torque_from": "controller" if inferred else "recorded",
            "warnings": [
                *case.warnings,
                *still_note(case),
                *short_note(case),
                *case.notes,
                *self.warnings(reached),
            ],
            "considered": self.considered(),
        }
