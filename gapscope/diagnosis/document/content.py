"""The content of ``diagnosis.json``, written from the comparison of a case with a data sheet or a reference."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from gapscope.arm.nominal import NominalArm, arm_entry
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import SMALLEST
from gapscope.diagnosis.comparison import Comparison, names_of
from gapscope.diagnosis.document.findings import (
    LISTED_ALTERNATIVE,
    GapStages,
    alternative_entry,
    numbers,
    region_entry,
    settled_by,
    share_entry,
    states_entry,
    suggested_recording,
    with_faults,
    with_states,
    with_torques_turned,
)
from gapscope.diagnosis.document.wording import Verdict, verdict, with_slide_units
from gapscope.diagnosis.gap.commanded_torque import WARNING
from gapscope.diagnosis.gap.plausible_data import short_note, still_note
from gapscope.diagnosis.locate import MotionRows, located, regions
from gapscope.diagnosis.selection.undeclared_coupling import UndeclaredCoupling
from gapscope.diagnosis.thresholds import FALSE_DISCOVERY_RATE, UNKNOWN_TORQUE
from gapscope.effects.effect import External
from gapscope.model.changes import Change, change_findings
from gapscope.model.conditioning import TORQUE_CUTOFF
from gapscope.model.terms import Candidate


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


def nominal_friction(arm: NominalArm) -> dict[str, Any]:
    """The friction that the nominal arm has, and where it comes from."""
    return {
        "source": arm.friction_source or None,
        "coulomb": arm.coulomb.tolist(),
        "viscous": arm.viscous.tolist(),
    }


class Document:
    """Parts of the document of a comparison; what a comparison with something says beside, it says in its own way.

    Args:
        comparison: of which all is written.
    """

    floor_from: str
    """Where the floor comes from, in words."""
    fitted_to = ""
    """What values are fitted to beside the case, in words."""

    def __init__(self, comparison: Comparison) -> None:
        self._comparison, self._known = comparison, comparison.explained
        self._prepared, self._rows = comparison.prepared, motion_rows(comparison)

    # What a comparison says in its own way.

    def arm(self) -> NominalArm:
        """The nominal arm as it was declared."""
        return self._prepared.case.arm

    def load(self) -> np.ndarray:
        """Torque by which regions tell much load from little [N m], (M, n)."""
        raise NotImplementedError

    def unknown2(self) -> np.ndarray:
        """Mean square of the torque that has an unknown cause, over the scale's square [1], (n,)."""
        raise NotImplementedError

    def times_floor(self) -> np.ndarray:
        """What is left over the floor, (n,)."""
        return np.asarray(self.stages.corrected / self.stages.floor)

    def replay(self) -> dict[str, Any]:
        """Entries on the replay, of the gap before and after the findings, by ``gap``, ``before`` and ``after``."""
        nothing: dict[str, Any] = {"replay_rmse": None, "replay_elsewhere": {}}
        unknown: dict[str, Any] = {"replayed": None, "engine": None}
        return {"gap": unknown, "before": nothing, "after": nothing}

    def effect_entry(self, name: str) -> dict[str, Any]:
        """What a finding says beside what all say."""
        return {}

    def unknown_entry(self, joints: list[int]) -> dict[str, Any]:
        """What is said of what is left."""
        return {"predictable": [], "coupling": None}

    def coupling(self) -> UndeclaredCoupling | None:
        """Two joints that seem to be turned by one motor."""
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

    # What all say.

    def open_joints(self) -> list[int]:
        """Joints, from 1, with something unknown."""
        # zero where nothing is unknown
        return [int(j) + 1 for j in np.flatnonzero(self.unknown2())]

    def knows_most(self) -> bool:
        """Whether what is named explains more of the gap, and of that of each joint, than what is unknown."""
        gap, unknown2 = self.stages, self.unknown2()
        # a repaired fault explains all that it took away
        before2 = np.maximum(gap.recorded, gap.repaired) ** 2
        closed2 = np.clip(before2 - gap.corrected**2, 0.0, None)
        most = unknown2.sum() <= closed2.sum()
        return bool(most and (unknown2 <= closed2).all())

    @property
    def rejected(self) -> bool:
        """Whether an effect explains recordings and does not predict others."""
        return False

    @cached_property
    def stages(self) -> GapStages:
        """The gap at the stages of the diagnosis."""
        known = self._known
        repaired = known.nrmse(known.before)
        faults = self._prepared.faults
        # the gap with all faults in it; without faults nothing was put right
        recorded = [f.gap_before for f in faults if f.gap_before is not None]
        return GapStages(
            recorded=recorded[0] if recorded else repaired,
            repaired=repaired,
            corrected=known.nrmse(known.after),
            floor=self.floor() / known.scale,
        )

    def floor(self) -> np.ndarray:
        """RMS that a healthy arm leaves [N m], (n,)."""
        return self._known.floor

    def content(self) -> dict[str, Any]:
        """The whole document."""
        comparison, prepared = self._comparison, self._prepared
        gap, joints = self.stages, self.open_joints()
        found = [self._finding(name) for name in comparison.named]
        found = with_torques_turned(_by_share(found), self.arm().n_joints)
        here = with_faults(found, prepared.faults, gap)
        # after the shares are one whole: another state has a gap of its own
        effects = with_states(
            here, prepared.states, comparison.terms, comparison.own_theta
        )
        possible = _by_share([self._finding(name) for name in comparison.possible])
        possible = [{**f, "settled_by": settled_by(f)} for f in possible]
        reached = self.reached
        # where the arm was compared nothing need have changed
        unchanged = reached != self._verdict(found=bool(here))
        closed = None if unchanged else gap.closed
        # what stays on a joint is worth a recording only where the verdict says that it is unexplained
        unexplained = joints if reached == "unexplained" else []
        doubt, first = self.doubt(reached)
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
            **states_entry(prepared.states.found),
            "closed": closed,
            "unexplained": {
                "share": 0.0 if closed is None else 1.0 - closed,
                "above_floor": bool(unexplained),
                "joints": joints,
                "times_floor": numbers(self.times_floor()),
                "where": self.where("after", joints),
                **self.unknown_entry(joints),
            },
            "next_recording": suggested_recording(
                reached, effects, possible, unexplained, self.coupling(), first
            ),
            "where": self.where("before", self._widest_first()),
            **self.further(),
        }
        content |= self._context(reached)
        if first and not prepared.another_arm:
            content["warnings"].insert(0, f"{doubt}; {first}")
        return with_slide_units(content, self.arm().sliding)

    @cached_property
    def _changes(self) -> list[Change]:
        """Changes during recordings, but those of a force from outside at a time at which an effect has one."""
        out = list(self._prepared.changes)
        for name in self._comparison.named:
            applied = self._comparison.change(name)
            if not isinstance(applied.effect, External):
                continue
            times = self._comparison.findings[name][0].term.parametrisation.nonlinear
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
        comparison, prepared = self._comparison, self._prepared
        # a fault or a change is a cause as well as an effect
        found = comparison.named or prepared.faults or self._changes
        return self._verdict(found=bool(found or prepared.states.others))

    def _verdict(self, *, found: bool) -> Verdict:
        return verdict(
            found=found,
            unknown=self._prepared.another_arm or not self.knows_most(),
            rejected=self.rejected,
        )

    def _gap(self) -> dict[str, Any]:
        gap, replay = self.stages, self.replay()
        before = {"torque_nrmse": numbers(gap.recorded), **replay["before"]}
        return {
            **replay["gap"],
            "before": {**before, "floor": numbers(gap.floor)},
            "after": {"torque_nrmse": numbers(gap.corrected), **replay["after"]},
        }

    def _finding(self, name: str) -> dict[str, Any]:
        """Evidence, values, gaps and places of a finding."""
        comparison, known = self._comparison, self._known
        mine, applied = comparison.findings[name], comparison.change(name)
        own = np.asarray(sum(self._torque(one) for one in mine))
        # the gap after holds what is named: it is put back to see the gap without it
        in_model = name in comparison.named
        only = known.before - own
        without = known.after + own if in_model else known.after
        # what is only possible is judged as if it were there as well
        left = known.after if in_model else known.after - own
        probability = comparison.probabilities[name]
        alternatives = comparison.alternatives(name)
        # what it closes of the square in each row
        closed = np.sqrt(np.clip(without**2 - left**2, 0.0, None))
        closed_first, closed_last = (
            float((known.nrmse(more) - known.nrmse(less)).sum())
            for more, less in ((known.before, only), (without, left))
        )
        # an effect without joints is shown where it closes most
        joints = list(applied.joints) or _most_closed(closed)
        # one region for each joint: where this finding acts most
        places = regions(closed, self._rows, self.load(), joints, most=1)
        entry = {
            "effect": applied.name,
            "joints": list(applied.joints),
            "probability": probability,
            "set": names_of(applied.name, probability, alternatives),
            "support": comparison.support(name),
            "gap_with_only_this": {"torque_nrmse": numbers(known.nrmse(only))},
            "gap_without_this": {"torque_nrmse": numbers(known.nrmse(without))},
            "where": [region_entry(region) for region in places],
            "alternatives": [
                alternative_entry(applied.name, other)
                for other in alternatives
                if other.probability > LISTED_ALTERNATIVE
            ],
            "carried_by": self._carried_by(closed),
            "parameters": comparison.parameters(name),
            **share_entry(closed_first, closed_last, self.stages.whole),
            **self._significance(name),
        }
        further = self.effect_entry(name)
        # both have entries here: torque gaps above, replay gaps in what is further
        for gap in ("gap_with_only_this", "gap_without_this"):
            entry[gap] |= further.pop(gap, {})
        return entry | further

    def _torque(self, one: Candidate) -> np.ndarray:
        """What a candidate does to the torque [N m], (M, n); of one that is not named, as it was fitted to all."""
        if one in self._known.torque:
            return self._known.torque[one]
        return self._comparison.torque_of(one)

    def _significance(self, name: str) -> dict[str, Any]:
        """Evidence for a finding, and the share of false ones among those as sure."""
        comparison, probabilities = self._comparison, self._comparison.probabilities
        as_sure = [
            1.0 - probabilities[other]
            for other in comparison.findings
            if probabilities[other] >= probabilities[name]
        ]
        rate = float(np.mean(as_sure))
        return {
            "log_e": comparison.log_odds(name),
            "false_discovery_rate": rate,
            "confirmed": rate <= FALSE_DISCOVERY_RATE,
        }

    def _carried_by(self, closed: np.ndarray) -> dict[str, Any]:
        """Shares of the squares that a finding closes, over the noise: by joint, and by recording."""
        comparison = self._comparison
        # noise is over the scale of the torque: back to (N m)^2
        noise2 = comparison.fit.contrast.error.noise2 * comparison.rows.scale**2
        nats = closed**2 / noise2
        total = max(float(nats.sum()), SMALLEST)
        segments = self._rows.segment
        recordings: dict[str, float] = {}
        for k, name in enumerate(self._rows.names):
            share = float(nats[segments == k].sum()) / total
            # segments of one recording add up, rounding not beyond one
            recordings[name] = min(recordings.get(name, 0.0) + share, 1.0)
        return {
            "joints": numbers(nats.sum(axis=0) / total),
            "recordings": recordings,
        }

    def where(self, stage: str, joints: list[int]) -> list[dict[str, Any]]:
        """Regions in which the gap ``before`` or ``after`` the findings is concentrated."""
        error = self._known.before if stage == "before" else self._known.after
        places = located(error, self._rows, self.load(), self.floor(), joints)
        return [region_entry(region) for region in places]

    def _widest_first(self) -> list[int]:
        """Joints, from 1, whose gap is above the floor by what is worth a search."""
        nrmse, floor = self.stages.repaired, self.stages.floor
        # squares of independent parts add up
        above = nrmse**2 > floor**2 + UNKNOWN_TORQUE**2
        return [int(j) + 1 for j in np.argsort(-nrmse) if above[j]]

    def _context(self, reached: str) -> dict[str, Any]:
        """The arm, the recordings, how they were conditioned, and what was noticed."""
        comparison, prepared = self._comparison, self._prepared
        # the warning is how a case says that its torque was worked out
        case, told = prepared.case, prepared.told is not None
        inferred = told or WARNING in case.warnings
        return {
            "arm": arm_entry(self.arm()),
            "recordings": [
                *(recording_entry(r, "fit") for r in case.recordings),
                *(recording_entry(r, "judge") for r in case.judged),
            ],
            "conditioning": {
                "rate": comparison.rows.segments[0].motion.rate,
                "position_cutoff": prepared.position_cutoff,
                "torque_cutoff": TORQUE_CUTOFF,
                "how": "zero-phase Butterworth, order 4, on both sides; positions cut where their spectrum meets its "
                f"noise; floor from {self.floor_from}",
            },
            "judged_on": self._judged_on(inferred),
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

    def _judged_on(self, inferred: bool) -> str:
        """On which data the gaps are measured, in words."""
        text = f"each motion, with the values fitted to {self.fitted_to}all others"
        if self._comparison.set_aside:
            text = "recordings set aside for judging"
        if inferred:
            text += (
                "; the torque there is the one that the controller must have commanded"
            )
        return text


def motion_rows(comparison: Comparison) -> MotionRows:
    """The rows on which the gap is measured, as what locates a gap takes them."""
    rows, mine = comparison.judged_on, comparison.explained.rows
    # rows hold no accelerations of their own
    ddq = np.concatenate([rows.thin(s.motion.ddq, s) for s in rows.segments])
    # a part of all segments may be looked at: these are counted from 0 again
    numbers_of, segment = np.unique(rows.segment[mine], return_inverse=True)
    own = [rows.segments[k] for k in numbers_of]
    first = [rows.t[mine][segment == k][0] for k in range(len(own))]
    return MotionRows(
        t=rows.t[mine] - np.array(first)[segment],
        q=rows.position[mine],
        dq=rows.velocity[mine],
        ddq=ddq[mine],
        segment=segment,
        # of the rows, which are thinned
        rates=tuple(s.motion.rate / rows.step(s) for s in own),
        names=tuple(s.recording for s in own),
        starts=tuple(float(t) for t in first),
    )


def _most_closed(closed: np.ndarray) -> list[int]:
    """The two joints, from 1, on which most is closed."""
    most = np.argsort(-(closed**2).sum(axis=0))[:2]
    return [int(j) + 1 for j in most]


def _by_share(findings: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    return sorted(findings, key=lambda finding: -finding["share"])
