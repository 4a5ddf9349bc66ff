"""From parts of a recording to events: learns what is normal, then asks again and again what has changed since."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.joint_units import joint_unit
from gapscope.arm.motions.motion import Motion
from gapscope.arm.recording import Recording
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.change_findings import (
    PLAIN_FRICTION,
    called,
    change_findings,
)
from gapscope.model.changes import SPANS, Change, Learnt, changes_since
from gapscope.model.conditioning import TORQUE_CUTOFF, Segment, thinned
from gapscope.model.design import FreeArm, design, fitted_arm
from gapscope.model.difference import Fit
from gapscope.model.equations import Equations
from gapscope.model.form_error import FormError, learn
from gapscope.model.rows import Kept, Rows
from gapscope.model.terms import Term
from gapscope.watching.alarm import NOTE, Event, Size
from gapscope.watching.segments import BLOCK, SegmentStream, Slip
from gapscope.watching.wording import (
    Name,
    Time,
    alarm,
    drift_note,
    misfit,
    noise_alarm,
    slipped,
)

LEARN = 60.0
"""Motion from which normal behaviour is learnt [s]. (budget)"""
LEAST_BLOCKS = 10
"""Blocks to learn from at least: fewer hold fewer equations than there are parameters."""
RATE = 100.0
"""Motions are reduced to no less than this rate, twice Nyquist of the torque's band [Hz]. (budget)"""
NOW = 60.0
"""Motion that is compared with what was learnt: a change that is slower is a drift [s]. (definition)"""
LOOK = 6.0
"""Motion from one look to the next [s]. (budget)"""
SLOWEST = 4
"""Looks at most from one to the next, while what is promised turns out to be nothing new. (budget)"""
LEAST_STEP = 1e-2
"""Share of a step by which the grids of two blocks may differ and are one [1]. (as ``conditioning.uniform``)"""
MOVED = 0.025
"""A block in which no joint moves by this much says nothing [rad]: a quarter of it at 0.05 rad/s. (physical)"""
APART = 1.0
"""Between two recordings, whose clocks need not agree, on the clock of the stream [s]. (definition)"""
NAMED = 0.5
"""Probability from which a change has its name [1]. (definition)"""
DRIFT = 0.25
"""Share by which friction has to drift for a note, and each time again [1]. (definition)"""
ENOUGH = 2.0
"""Standard errors of an interval of 95 %. (definition)"""
DAY = 86_400.0
"""Seconds."""
SPAN = NOW / SPANS
"""Motion in which a change is looked for at first [s]."""


@dataclass(frozen=True)
class Block:
    """A piece of a recording, on the clock of the stream.

    Attributes:
        segment: its samples.
        offset: what the clock of the stream shows at the zero of the recording's [s].
    """

    segment: Segment
    offset: float

    @property
    def begin(self) -> float:
        """Its first sample that counts, on the clock of the stream [s]."""
        return float(self.segment.motion.t[self.segment.inner][0])

    @property
    def end(self) -> float:
        """Its last sample that counts, on the clock of the stream [s]."""
        return float(self.segment.motion.t[self.segment.inner][-1])


@dataclass
class State:
    """All that a detector remembers, of an arm with n joints.

    Attributes:
        seen: what was learnt, or what is being learnt.
        now: the last motion after it.
        band: of the torque [Hz]; 0 while it is learnt.
        known: what has changed in it, since when on the clock of the stream [s], and by how much.
        free: what changed before it, standard deviations of its coordinates.
        drift: steps of ``DRIFT`` by which each joint's friction has drifted so far, (n,).
        said: friction that alarms have named so far, at the usual speed [N m], (n,).
        looked: when the last look was [s].
        pace: looks that the next one comes after: more if what was promised turned out to be nothing new.
        unknown: joints from 1 on which the last look saw something unknown, and since when [s].
    """

    drift: np.ndarray
    said: np.ndarray
    seen: list[Block] = field(default_factory=list)
    now: list[Block] = field(default_factory=list)
    band: float = 0.0
    known: dict[tuple[Term, float], np.ndarray] = field(default_factory=dict)
    free: dict[Term, np.ndarray] = field(default_factory=dict)
    looked: float = 0.0
    pace: int = 1
    unknown: dict[int, float] = field(default_factory=dict)

    @property
    def blocks(self) -> list[Block]:
        """All of them, the oldest first."""
        return [*self.seen, *self.now]


class Detector:
    """Watches an arm, part by part of a recording.

    Args:
        corrected: the arm with its effects.
        false_alarms: wanted per 24 h of motion at most.
        learning: motion from which normal behaviour is learnt [s]; 0 if ``learn_from`` says what it is.

    Attributes:
        stream: cuts parts into blocks.
        state: what is remembered.
    """

    def __init__(
        self,
        corrected: CorrectedArm,
        false_alarms: float = 0.1,
        learning: float = LEARN,
    ) -> None:
        self.corrected, self.stream = corrected, SegmentStream()
        n = corrected.arm.n_joints
        self.state = State(np.zeros(n, dtype=int), np.zeros(n))
        self._nominal = CorrectedArm(corrected.arm)
        self._body = RigidBody(corrected.arm)
        self._wanted = round((learning or LEARN) / BLOCK)
        # by Ville's inequality evidence is beyond these odds no more often by chance
        self._asked = DAY / SPAN / false_alarms
        self._about: FreeArm | None = None
        self._holding: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self._kept: Kept | None = None
        self._taught: tuple[FormError, Equations] | None = None

    @property
    def learnt(self) -> float:
        """Share of the motion to learn from that was seen [1]."""
        state = self.state
        return 1.0 if state.band else len(state.seen) / self._wanted

    def add(self, part: Recording) -> Iterator[Event]:
        """Events of the next part of a recording, of the same name as before or a new one."""
        for item in self.stream.add(part):
            if isinstance(item, Slip):
                yield slipped(item, self.corrected.arm.sliding)
            elif np.ptp(item.motion.q, axis=0).max() >= MOVED:
                yield from self._added(self._block(item))

    def learn_from(self, recordings: Iterable[Recording]) -> Event:
        """Take recordings as normal, such as those of an earlier diagnosis.

        Raises:
            InputError: none of them has a torque and enough motion.
        """
        for recording in recordings:
            for item in (*self.stream.add(recording), *self.stream.finish()):
                if isinstance(item, Segment):
                    self.state.seen.append(self._block(item))
        if len(self.state.seen) < LEAST_BLOCKS:
            raise InputError(
                f"the case's recordings hold {len(self.state.seen) * BLOCK:.0f} s of motion with torque, "
                f"at least {LEAST_BLOCKS * BLOCK:.0f} s are needed to learn from",
                "learn from the arm's own motion: --learn 60",
                where="--learn",
            )
        return self._learn()

    def _block(self, segment: Segment) -> Block:
        """A segment on the clock of the stream, its torque without what effects of the arm are known to do."""
        segment = thinned(segment, RATE)
        motion, torque = segment.motion, segment.torque
        assert torque is not None
        if self.corrected.effects:
            body = segment.bodies(self._body)
            known = self.corrected.unlimited.predict(body, motion)
            without = self._nominal.predict(body, motion)
            torque = self.corrected.delivered(torque) - known + without
        last = self.state.blocks[-1:]
        offset = 0.0
        if last:
            offset, before = last[0].offset, last[0].segment.recording
            # clocks of two recordings need not agree
            if before != segment.recording or motion.t[0] + offset < last[0].begin:
                offset = last[0].end + APART - float(motion.t[segment.inner][0])
        on_clock = Motion(motion.t + offset, motion.q, motion.dq, motion.ddq)
        return Block(replace(segment, motion=on_clock, torque=torque), offset)

    def _added(self, block: Block) -> Iterator[Event]:
        state = self.state
        if not state.band:
            state.seen.append(block)
            if len(state.seen) >= self._wanted:
                yield self._learn()
            return
        state.now = [*state.now, block][-round(NOW / BLOCK) :]
        # each span has some motion
        if len(state.now) >= SPANS and block.end >= state.looked + LOOK * state.pace:
            state.looked = block.end
            self._forget(state.now[0].begin)
            yield from self._look()

    def _forget(self, begin: float) -> None:
        """What changed before the motion that is compared may have any value like it all along."""
        state = self.state
        for (term, since), value in list(state.known.items()):
            if since > begin:
                continue
            del state.known[term, since]
            if called(term)[0] == PLAIN_FRICTION:
                state.said[term.joint - 1] += self._at_speed(term) * value[0]
            size, shares = np.abs(value), term.parametrisation.proportions
            if shares is not None:
                size = np.maximum(size, size[0] * np.array(shares))
            state.free[term] = np.maximum(size, state.free.get(term, 0.0))

    def _learn(self) -> Event:
        """End of learning."""
        state = self.state
        state.band = min(TORQUE_CUTOFF, self.stream.cutoff or TORQUE_CUTOFF)
        self.prepare()
        last = state.seen[-1]
        every = [np.ptp(block.segment.motion.q, axis=0) for block in state.seen]
        rested = np.flatnonzero(np.max(every, axis=0) < MOVED)
        text = f"learnt {len(state.seen) * BLOCK:.0f} s of motion"
        if len(rested):
            text += f", in which {', '.join(f'J{j + 1}' for j in rested)} rested"
        return Event(
            event=NOTE,
            sentence=text,
            recording=last.segment.recording,
            detected=last.end - last.offset,
        )

    def prepare(self) -> None:
        """Fit the arm that predicts what was learnt."""
        rows = self._rows([])
        self._about = fitted_arm(rows, self.corrected.arm, (0,))
        self._holding, self._kept = rows.holding, Kept(self._about, {})
        first = Equations.of(design(rows, self._about, {}))
        self._taught = learn(first, (0,)), first

    def _rows(self, now: list[Block]) -> Rows:
        groups = [[[block.segment for block in self.state.seen]]]
        if now:
            groups.append([[block.segment for block in now]])
        return Rows(groups, self.state.band, len(groups))

    def _whole(self) -> Rows:
        """All motion, blocks that follow each other in one segment."""
        groups = [[joined(self.state.seen)], [joined(self.state.now)]]
        rows = Rows(groups, self.state.band, len(groups))
        assert self._holding
        rows.held(*self._holding)
        return rows

    def _look(self) -> Iterator[Event]:
        """What has changed, if anything has."""
        state = self.state
        assert self._about and self._holding and self._taught and self._kept
        rows = self._rows(state.now)
        rows.held(*self._holding)
        now = {id(block.segment) for block in state.blocks}
        parts = self._kept.parts
        for gone in parts.keys() - now:
            del parts[gone]
        rows.kept = self._kept
        learnt = Learnt(self._about, self._asked, state.free, self._taught)
        said = changes_since(rows, state.known, learnt, self._whole)
        # a single look may meet an odd motion, or a change too new to be told
        again = sorted(set(said.unknown) & set(state.unknown))
        state.unknown = dict(said.unknown)
        if said.changes is not None:
            yield from self._changed(said.changes, said.others)
            return
        state.pace = 1
        if not again:
            yield from self._drifted(said.fit)
        elif said.louder:
            begun = min(since for _, since in said.louder.values())
            growth = {j: ratio for j, (ratio, _) in said.louder.items()}
            yield noise_alarm(growth, self._time(begun))
            self._learn_anew(begun)
        else:
            yield self._misfit(again, min(said.unknown[j] for j in again))

    def _changed(
        self, changes: Iterable[Change], by_term: Mapping[Term, float]
    ) -> Iterator[Event]:
        """Alarms of what has changed."""
        state = self.state
        changes = list(changes)
        new = [change for change in changes if not self._is_known(change)]
        state.pace = 1 if new else min(2 * state.pace, SLOWEST)
        # what is in the last samples alone may be a push
        if any(state.now[-1].end - change.time < SPAN / 2 for change in new):
            return
        likely: dict[Name, float] = {}
        for term, probability in by_term.items():
            name = called(term)
            likely[name] = min(likely.get(name, 0.0) + probability, 1.0)
        named = [one for one in new if likely[called(one.term)] >= NAMED]
        if new and not named:
            yield self._misfit([], min(change.time for change in new))
            return
        state.known = {(c.term, c.time): c.value for c in changes}
        said = {called(change.term) for change in changes}
        others = {name: p for name, p in likely.items() if name not in said}
        speed, sliding = self._speed(), self.corrected.arm.sliding
        for finding in change_findings(named):
            name = finding["what"], tuple(finding["joints"])
            # friction as a whole, not a coefficient of it
            finding["probability"] = likely.get(name, finding["probability"])
            when = self._time(finding["time"], tuple(finding["interval"]))
            yield alarm(finding, when, others, speed, sliding)

    def _is_known(self, change: Change) -> bool:
        return any(
            called(term) == called(change.term) and abs(change.time - since) < SPAN
            for term, since in self.state.known
        )

    def _misfit(self, joints: list[int], begun: float) -> Event:
        """The event of what has no name, after which all is learnt anew."""
        event = misfit(joints, self._time(begun))
        self._learn_anew(begun)
        return event

    def _learn_anew(self, begun: float) -> None:
        """What is like this from now on is normal."""
        after = [block for block in self.state.now if block.begin >= begun]
        n = len(self.state.drift)
        self.state = State(np.zeros(n, dtype=int), np.zeros(n), after)
        self._about = self._kept = None

    def _drifted(self, fit: Fit) -> Iterator[Event]:
        """Notes on friction that has drifted by a further step."""
        state, about, made = self.state, self._about, fit.contrast.design
        assert about is not None
        _, own = fit.own.nuisances(fit.answer.values)
        frictions: dict[int, list[Term]] = {}
        for term in made.places:
            sheet = term.parametrisation.data_sheet
            if called(term)[0] == PLAIN_FRICTION and sheet is not None:
                frictions.setdefault(term.joint - 1, []).append(term)
        for j, terms in frictions.items():
            at = np.array([self._at_speed(term) for term in terms])
            places = [int(made.places[term][0]) for term in terms]
            per_column = at / np.array([made.units[term][0] for term in terms])
            level = at @ about.theta[[term.columns[0] for term in terms]]
            if level <= 0 or not all(own[-1, places]):
                continue
            moved = per_column @ own[-1, places] - state.said[j]
            spread = fit.contrast.own_covariance(places)
            std = float(np.sqrt(per_column @ spread @ per_column))
            steps, before = int(moved / level / DRIFT), state.drift[j]
            further = abs(steps) > abs(before) or steps * before < 0
            if further and abs(moved) > ENOUGH * std:
                state.drift[j] = steps
                unit = joint_unit("N m", self.corrected.arm.sliding[j])
                size = Size(float(moved), std, unit)
                when = self._time(state.now[-1].end)
                yield drift_note(j + 1, size, float(moved / level), when)

    def _at_speed(self, term: Term) -> float:
        """Torque of a friction coefficient of 1 at the joint's usual speed [N m]."""
        viscous = term.parametrisation.data_sheet == "viscous"
        return float(self._speed()[term.joint - 1]) if viscous else 1.0

    def _speed(self) -> np.ndarray:
        """RMS speed of the joints in the last motion [rad/s], (n,)."""
        every = [block.segment.motion.dq for block in self.state.now]
        return np.asarray(np.sqrt((np.concatenate(every) ** 2).mean(axis=0)))

    def _time(self, begun: float, interval: tuple[float, ...] | None = None) -> Time:
        """A moment on the clock of the stream by the clock of its recording."""
        blocks = self.state.blocks
        here = next((b for b in blocks if b.end >= begun), blocks[-1])
        name, offset = here.segment.recording, here.offset
        mine = [b for b in blocks if b.segment.recording == name]
        # what changed between two recordings shows from the first sample on
        begun = max(begun, mine[0].begin)
        low, high = interval or (begun, begun)
        low, high = max(low, mine[0].begin), min(high, mine[-1].end)
        last = blocks[-1]
        return Time(
            name, begun - offset, (low - offset, high - offset), last.end - last.offset
        )


def joined(blocks: list[Block]) -> list[Segment]:
    """Segments of blocks, those that follow each other on one grid in one."""
    out: list[Segment] = []
    for block in blocks:
        more = _joined(out[-1], block.segment) if out else None
        if more is None:
            out.append(block.segment)
        else:
            out[-1] = more
    return out


def _joined(before: Segment, after: Segment) -> Segment | None:
    """Two segments in one, the overlap parted in its middle; ``None`` if they do not follow each other."""
    t, further = before.motion.t, after.motion.t
    step = (t[-1] - t[0]) / (len(t) - 1)
    same = before.recording == after.recording and before.payload == after.payload
    middle = (t[-1] + further[0]) / 2
    first, rest = t <= middle, further > middle
    if not same or further[0] > t[-1] or not (first.any() and rest.any()):
        return None
    # the grids of both are one
    if abs(further[rest][0] - t[first][-1] - step) > LEAST_STEP * step:
        return None

    def both(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        return np.concatenate([one[first], other[rest]])

    a, b = before.motion, after.motion
    motion = Motion(
        both(t, further), both(a.q, b.q), both(a.dq, b.dq), both(a.ddq, b.ddq)
    )
    unknown = None
    if before.unknown is not None or after.unknown is not None:
        unknown = both(~before.measured, ~after.measured)
    torque = both(np.asarray(before.torque), np.asarray(after.torque))
    return replace(before, motion=motion, torque=torque, unknown=unknown)
