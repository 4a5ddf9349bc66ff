"""What a watch can say: alarms, misfits and drifts, in words and as lines of a file."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gapscope.arm.display import effect_name
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.json_file import plain
from gapscope.arm.io.records_file import read_records, write_records
from gapscope.arm.io.table import GAP_STEPS
from gapscope.arm.joint_units import joint_unit
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.motions.motion import Motion
from gapscope.arm.recording import Recording
from gapscope.effects.catalogue import of_quantity
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.changes import (
    PAYLOAD,
    PLAIN_FRICTION,
    SPANS,
    Change,
    Learnt,
    Since,
    called,
    change_findings,
    changes_since,
)
from gapscope.model.conditioning import (
    TORQUE_CUTOFF,
    TRIM,
    Segment,
    condition,
    pieces,
    position_cutoff,
    slips,
    thinned,
)
from gapscope.model.design import FreeArm, design, fitted_arm
from gapscope.model.difference import Fit
from gapscope.model.equations import Equations, FormError, learn
from gapscope.model.rows import MIN_MOTIONS, MODEL_RATE, Kept, Rows
from gapscope.model.terms import Term

# What a watch says: an alarm, a misfit, a drift or a note, as one JSON line and as a sentence.


SCHEMA = 1
"""Version of the form of the lines."""
ALARM, MISFIT, DRIFT, NOTE = "alarm", "misfit", "drift", "note"
"""Kinds of events."""


@dataclass(frozen=True)
class Size:
    """A value with its standard error.

    Attributes:
        value, std: in the unit.
        unit: SI.
    """

    value: float
    std: float
    unit: str

    def __str__(self) -> str:
        """With sign and unit."""
        return f"{self.value:+.3g} ± {self.std:.2g} {self.unit}"


@dataclass(frozen=True)
class Event:
    """Something that a watch has to say.

    Attributes:
        event: ``alarm``, ``misfit``, ``drift`` or ``note``.
        effect: what changed: an effect of the catalogue, ``friction`` or ``other``; empty for a note.
        change: in a word or two: ``picked up``, ``risen``; empty for a note.
        joints: from 1; empty for the whole arm.
        recording: in which it happened.
        time: when it began, in the recording's time [s]; ``None`` if it has none.
        interval: in which it began with a probability of 95 % [s]; ``None`` if that is not known.
        detected: time of the last sample that was known [s], or ``None``.
        until: when all of it had changed, if it took a while and that is over [s], or ``None``.
        sizes: by name of the parameter.
        evidence: numbers that led to it.
        alternatives: what else would explain it nearly as well.
        sentence: the same for a reader.
    """

    event: str
    sentence: str
    effect: str = ""
    change: str = ""
    joints: Sequence[int] = ()
    recording: str = ""
    time: float | None = None
    interval: tuple[float, float] | None = None
    detected: float | None = None
    until: float | None = None
    sizes: Mapping[str, Size] = field(default_factory=dict)
    evidence: Mapping[str, float] = field(default_factory=dict)
    alternatives: Sequence[Mapping[str, Any]] = ()

    def as_line(self, number: int) -> str:
        """One line of JSON in the form of ``event.schema.json``, without the new line.

        Args:
            number: of the event, from 1, counted over all runs of a watch.
        """
        content = {"schema": SCHEMA, "number": number, **asdict(self)}
        return json.dumps(plain(content), ensure_ascii=False, allow_nan=False)


# What changed as an event: its name, its sizes with errors, and the sentence for a reader.


OTHER = "other"
"""Effect of what has no name."""
ENCODER = of_quantity("zero")[0].name
NEARLY = 0.05
"""Probability from which another name is told [1]. (definition)"""

Name = tuple[str, tuple[int, ...]]
"""What changed, as ``change_findings`` calls it, and on which joints."""


class Time(NamedTuple):
    """A moment by the clock of a recording, and that of the last sample that was known then [s].

    A change that takes a while goes on ``until`` a moment; beyond ``detected`` it still does.
    """

    recording: str
    begun: float
    interval: tuple[float, float] | None
    detected: float
    until: float | None = None

    @property
    def text(self) -> str:
        """``at 3.4 s of shift.csv``, ``from 3.4 to 9.1 s of shift.csv``."""
        if self.until is None:
            return f"at {self.begun:.1f} s of {self.recording}"
        if self.until >= self.detected:
            return f"little by little since {self.begun:.1f} s of {self.recording}, and goes on"
        return f"from {self.begun:.1f} to {self.until:.1f} s of {self.recording}"

    def event(
        self,
        kind: str,
        sentence: str,
        effect: str = OTHER,
        change: str = "changed",
        **more: Any,
    ) -> Event:
        """An event at this moment; without an effect, one of what has no name."""
        over = None if self.until is None or self.until >= self.detected else self.until
        return Event(
            kind,
            sentence,
            effect,
            change,
            recording=self.recording,
            time=self.begun,
            interval=self.interval,
            detected=self.detected,
            until=over,
            **more,
        )


def alarm(
    finding: Mapping[str, Any],
    when: Time,
    others: Mapping[Name, float],
    speed: np.ndarray,
    sliding: Sequence[bool],
    event: str = ALARM,
) -> Event:
    """The alarm of a change that has a name, or, of one that took a while and was told, a ``drift`` when it is over.

    Args:
        finding: as ``change_findings`` has it.
        when: it began.
        others: probability of other names.
        speed: RMS speed of the joints in motion [rad/s], (n,).
        sliding: which joints slide.
        event: ``drift`` when it is over.
    """
    what, joints = finding["what"], list(finding["joints"])
    sizes = _sizes(finding, speed, sliding)
    word = _direction(what, sizes)
    nearly = [
        (effect, list(at), p)
        for (effect, at), p in sorted(others.items(), key=lambda entry: -entry[1])
        if p >= NEARLY
    ]
    listed = [
        {"effect": effect, "joints": at, "evidence": -float(np.log(p))}
        for effect, at, p in nearly
    ]
    text = f"{_in_words(what, joints)} {word}"
    if nearly:
        names = [_in_words(effect, at) for effect, at, _ in nearly]
        text += f", or it is {', or '.join(names)}"
    size_text = ", ".join(f"{key} {size}" for key, size in sizes.items())
    return when.event(
        event,
        f"{text} {when.text}: {size_text}",
        what,
        word.removeprefix("was ").removeprefix("has "),
        joints=joints,
        sizes=sizes,
        evidence={
            "probability": finding["probability"],
            "times_threshold": finding["times_threshold"],
        },
        alternatives=listed,
    )


def slipped(when: Time, joint: int, size: Size) -> Event:
    """The alarm of an encoder whose reading jumped by a size, and stays off."""
    word = _direction(ENCODER, {"offset": size})
    text = f"{_in_words(ENCODER, [joint])} {word} {when.text}: its reading jumped by {size}"
    change = word.removeprefix("has ")
    sizes = {"offset": size}
    return when.event(ALARM, text, ENCODER, change, joints=[joint], sizes=sizes)


def noise_alarm(growth: Mapping[int, float], when: Time) -> Event:
    """The alarm of joints that leave more torque than any parameter explains.

    Args:
        growth: by joint from 1, a ratio of RMS.
        when: it began.
    """
    joints = sorted(growth)
    shown = [f"joint {j} leaves {growth[j]:.1f} times its usual torque" for j in joints]
    place = f"on joint {', '.join(map(str, joints))}"
    text = f"something else changed {place} {when.text}: {', '.join(shown)}"
    evidence = {f"growth_{j}": growth[j] for j in joints}
    return when.event(ALARM, text, joints=joints, evidence=evidence)


def misfit(joints: Sequence[int], when: Time) -> Event:
    """The model fits worse since some moment, and no cause explains it."""
    place = f" of joint {', '.join(map(str, joints))}" if joints else ""
    text = f"since {when.begun:.1f} s of {when.recording} the torque{place} fits the arm less well"
    text += ", and no single cause explains it: a motion that is new to the watch, or a change without a name"
    return when.event(MISFIT, text, joints=joints)


def drift_note(joint: int, size: Size, share: float, when: Time) -> Event:
    """Friction of a joint that drifted slowly by a share of what it was."""
    word = "risen" if share > 0 else "fallen"
    text = f"the friction of joint {joint} has slowly {word} by {abs(share):.0%} since it was learnt: {size}"
    return Event(
        event=DRIFT,
        sentence=f"{text} ({when.text})",
        effect=PLAIN_FRICTION,
        change=word,
        joints=[joint],
        recording=when.recording,
        detected=when.detected,
        sizes={"torque": size},
        evidence={"share": share},
    )


def _direction(what: str, sizes: Mapping[str, Size]) -> str:
    """``has risen``, ``has fallen``, or that it has changed if no single number says which."""
    main = next(iter(sizes.values()), None)
    up = main is not None and main.value > 0
    if what == PAYLOAD:
        return "was picked up" if up else "was put down"
    # of several numbers none says which way, but friction leads with its torque
    if main is None or (len(sizes) > 1 and what != PLAIN_FRICTION):
        return "has changed"
    return "has risen" if up else "has fallen"


def _sizes(
    finding: Mapping[str, Any], speed: np.ndarray, sliding: Sequence[bool]
) -> dict[str, Size]:
    """Sizes of a change by name, the one that decides on its direction first."""
    out: dict[str, Size] = {}
    slides = bool(finding["joints"]) and sliding[finding["joints"][0] - 1]
    for name, entry in finding["parameters"].items():
        values, stds = np.ravel(entry["value"]), np.ravel(entry["std"])
        unit = joint_unit(entry["unit"], slides)
        for k, (value, std) in enumerate(zip(values, stds, strict=True)):
            key = name if len(values) == 1 else f"{name}_{'xyz'[k]}"
            out[key] = Size(float(value), float(std), unit)
    if finding["what"] == PLAIN_FRICTION:
        # both coefficients as one torque: they are hard to tell apart at one speed
        at = {"coulomb": 1.0, "viscous": float(speed[finding["joints"][0] - 1])}
        torque = sum(at[key] * size.value for key, size in out.items())
        std = float(np.hypot.reduce([at[key] * size.std for key, size in out.items()]))
        unit = joint_unit("N m", slides)
        out = {"torque_at_usual_speed": Size(torque, std, unit), **out}
    return out


def _in_words(effect: str, joints: Sequence[int]) -> str:
    where = f" of joint {joints[0]}" if joints else ""
    if effect == PAYLOAD:
        return "a load"
    if effect == ENCODER:
        return f"the encoder's zero{where}"
    return f"the {effect_name(effect)}{where}"


# Events in a file, one JSON line each, appended.


EVENTS = "events.jsonl"
"""Name of the file in the folder of the results."""


class EventFile:
    """Appends events; each is on the disk before the next one.

    Args:
        path: of the file.
        count: events of earlier runs.

    Raises:
        GapscopeError: the file cannot be written.
    """

    def __init__(self, path: Path, count: int) -> None:
        self.path, self.count = path, count
        # what cannot be written to is told before the first event
        self._append("")

    def write(self, event: Event) -> None:
        """Append one line."""
        self._append(event.as_line(self.count + 1) + "\n")
        self.count += 1

    def _append(self, text: str) -> None:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("a", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise GapscopeError(
                f"{self.path}: cannot be written ({error.strerror})",
                "choose another folder, or check the permissions of this one",
            ) from None


# Samples as they come, cut into overlapping pieces and conditioned as a whole recording would be.


BLOCK = 2.0
"""Samples are conditioned in blocks of this length [s]. (budget)"""
FIRST = 10.0
"""The cut-off of the positions is chosen on this much of the first motion [s]. (budget)"""
WINDOW = BLOCK + 2 * TRIM
"""Length of a piece [s]: a block, and what trimming takes from both ends."""
MIN_LEFT = 2.0
"""The end of a recording is used if this much of it is left [s]."""
STILL = 1e-3
"""What a joint that stands still may travel [rad]: of that no band of a motion is known, and it is no slip. (physical)
"""


class SegmentStream:
    """Recordings that arrive in parts, as segments of ``WINDOW`` seconds whose trimmed samples follow each other.

    An encoder that slips is told, and what it slipped by is taken out of all that follows.

    Both ends of a recording lose ``TRIM`` seconds, as they do in a diagnosis. Of a recording
    that comes in small parts no more than ``FIRST`` seconds are held.

    Args:
        sliding: which joints slide.

    Attributes:
        cutoff: of the positions [Hz], the largest that a motion asked for so far (``position_cutoff``).
        held: samples that were not used yet.
        slipped: by how much encoders have slipped so far [rad or m], (n,), or 0.
    """

    def __init__(self, sliding: Sequence[bool]) -> None:
        self._sliding = sliding
        self.cutoff: float | None = None
        self.held: Recording | None = None
        self.slipped: np.ndarray | float = 0.0

    def add(self, part: Recording) -> Iterator[Segment | Event]:
        """The segments that are complete with the next part of a recording, of this name or a new one.

        Parts without torque end what came before them.
        """
        if self.held is not None and self._breaks(self.held, part):
            yield from self.finish()
        if part.tau is None:
            return
        # slips so far are taken out before anything looks at the part
        part = replace(part, q=part.q - self.slipped)
        own = part if self.held is None else _joined_segments(self.held, part)
        # nothing is cut into pieces before the band of a motion is known
        if self.cutoff is None:
            own = self._from_motion_on(own)
        self.held = own
        if self.cutoff is not None:
            yield from self._windows(own, WINDOW)

    def finish(self) -> Iterator[Segment | Event]:
        """The last segments of a recording that has ended, if what is left is long enough."""
        own, self.held = self.held, None
        if own is None or own.duration < MIN_LEFT:
            return
        if self.cutoff is not None or self._chosen(own):
            yield from self._windows(own, MIN_LEFT)
            self.held = None

    def _windows(self, own: Recording, least: float) -> Iterator[Segment | Event]:
        """Segments of windows that begin ``BLOCK`` seconds after each other while ``least`` seconds are left."""
        first = 0
        while own.t[-1] - own.t[first] >= least:
            begin = own.t[first]
            # one window, and where the next one begins: they overlap by what is trimmed
            stop = int(np.searchsorted(own.t, begin + WINDOW)) + 1
            following = int(np.searchsorted(own.t, begin + BLOCK))
            # on raw samples, before a filter smears them
            for jump in slips(own.part(slice(first, stop))):
                # beside a joint at rest any count of its encoder stands out
                if abs(jump.size) <= STILL:
                    continue
                k, joint = first + jump.sample, jump.joint + 1
                before, after = float(own.t[k - 1]), float(own.t[k])
                unit = joint_unit("rad", self._sliding[jump.joint])
                when = Time(own.name, after, (before, after), after)
                yield slipped(when, joint, Size(jump.size, jump.error, unit))
                gone = np.zeros(own.q.shape[1])
                gone[jump.joint] = jump.size
                # later parts have it as well
                self.slipped = self.slipped + gone
                late = np.arange(len(own.t)) >= k
                own = replace(own, q=own.q - gone * late[:, None])
            piece = own.part(slice(first, stop))
            # one sample stays, to which the next part is joined
            first = min(following, len(own.t) - 1)
            assert self.cutoff is not None
            # gaps may leave nothing that is long enough
            if pieces(piece):
                # a motion may be faster than all before it
                self.cutoff = max(self.cutoff, position_cutoff((piece,)))
                for segment in condition(piece, self.cutoff):
                    yield thinned(segment, MODEL_RATE)
        self.held = own.part(slice(first, None))

    def _from_motion_on(self, own: Recording) -> Recording:
        """What is left of the first samples when those before a motion are dropped; the cut-off is chosen on it."""
        while own.duration >= FIRST:
            first = own.part(own.t < own.t[0] + FIRST)
            if self._chosen(first):
                break
            # half of it once more: a motion may begin near its end
            own = own.part(own.t >= own.t[0] + 0.5 * FIRST)
        return own

    def _chosen(self, first: Recording) -> bool:
        """Whether the cut-off could be chosen on the first motion."""
        if np.ptp(first.q, axis=0).max() <= STILL:
            return False
        self.cutoff = position_cutoff((first,))
        return True

    @staticmethod
    def _breaks(held: Recording, part: Recording) -> bool:
        """Whether a part does not go on where the samples before it end."""
        if part.tau is None or part.name != held.name or len(held.t) < 2:
            return True
        step = float(part.t[0] - held.t[-1])
        # stamps that go back, or a pause, begin another recording
        return not 0 < step <= max(GAP_STEPS / held.rate, 0.1)


def _joined_segments(held: Recording, part: Recording) -> Recording:
    """Two parts of a recording, one after the other: time, positions and torque; turns between them taken back."""
    assert held.tau is not None and part.tau is not None
    # a part is unwrapped by itself: whole turns between both are not real
    turns = 2 * np.pi * np.round((part.q[0] - held.q[-1]) / (2 * np.pi))
    warmth = None
    if held.temperature is not None and part.temperature is not None:
        warmth = np.concatenate([held.temperature, part.temperature])
    return Recording(
        name=held.name,
        t=np.concatenate([held.t, part.t]),
        q=np.concatenate([held.q, part.q - turns]),
        tau=np.concatenate([held.tau, part.tau]),
        temperature=warmth,
        payload=held.payload,
    )


# From parts of a recording to events: learns what is normal, then asks again and again what has changed since.


LEARN = 60.0
"""Motion from which normal behaviour is learnt [s]. (budget)"""
MIN_BLOCKS = 10
"""Blocks to learn from at least: fewer hold fewer equations than there are parameters."""
NOW = 60.0
"""Motion that is compared with what was learnt: a change that is slower is a drift [s]. (definition)"""
LOOK = 6.0
"""Motion from one look to the next [s]. (budget)"""
SLOWEST = 4
"""Looks at most from one to the next, while what is promised turns out to be nothing new. (budget)"""
MIN_STEP = 1e-2
"""Share of a step by which the grids of two blocks may differ and are one [1]. (as ``conditioning.uniform``)"""
MOVED = 0.025
"""A block in which no joint moves by this much says nothing [rad]: a quarter of it at 0.05 rad/s. (physical)"""
APART = 1.0
"""Between two recordings, whose clocks need not agree, on the clock of the stream [s]. (definition)"""
NAMED = 0.5
"""Probability from which a change has its name [1]. (definition)"""
DRIFT_STEP = 0.25
"""Share by which friction has to drift for a note, and each time again [1]. (definition)"""
ENOUGH = 2.0
"""Standard errors of an interval of 95 %. (definition)"""
DAY = 86_400.0
"""Seconds."""
SPAN = NOW / SPANS
"""Motion in which a change is looked for at first [s]."""
WARM, USUAL_SPEED, COOLING = 30.0, 0.5, 1200.0
"""Kelvin by which a joint at work is warmer than one that rested, its mean speed then [rad/s], and the time constant
with which it warms and cools [s]; how much its friction follows is fitted. (physical)"""


@dataclass(frozen=True)
class Block:
    """A piece of a recording, on the clock of the stream.

    Attributes:
        segment: its samples.
        offset: what the clock of the stream shows at the zero of the recording's [s].
        begun: what the log's own clock shows then [s], 0 if it is not known.
        rested: temperature of the joints at rest, by that which was measured last [deg C], (n,), or 0.
    """

    segment: Segment
    offset: float
    begun: float = 0.0
    rested: np.ndarray | float = 0.0

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
        drift: steps of ``DRIFT_STEP`` by which each joint's friction has drifted so far, (n,).
        said: friction that alarms have named so far, at the usual speed [N m], (n,).
        looked: when the last look was [s].
        pace: looks that the next one comes after: more if what was promised turned out to be nothing new.
        unknown: joints from 1 on which the last look saw something unknown, and since when [s].
        over: changes that took a while and are over, as a drift has said, and until when [s].
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
    over: dict[Term, float] = field(default_factory=dict)

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
        self.corrected = corrected.lasting
        self.stream = SegmentStream(corrected.arm.sliding)
        n = corrected.arm.n_joints
        self.state = State(np.zeros(n, dtype=int), np.zeros(n))
        self._nominal = CorrectedArm(corrected.arm)
        self._body = RigidBody(corrected.arm)
        self._wanted = round((learning or LEARN) / BLOCK)
        # spans in a day, over the false alarms that are wanted in one
        # by Ville's inequality evidence is beyond these odds no more often by chance
        self._asked = DAY / SPAN / false_alarms
        self._about: FreeArm | None = None
        self._holding: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self._kept: Kept | None = None
        self._taught: tuple[FormError, Equations] | None = None
        self._begun: dict[str, float] = {}

    @property
    def learnt(self) -> float:
        """Share of the motion to learn from that was seen [1]."""
        state = self.state
        return 1.0 if state.band else len(state.seen) / self._wanted

    def add(self, part: Recording) -> Iterator[Event]:
        """Events of the next part of a recording, of the same name as before or a new one."""
        # a new recording ends the one before it
        self._begun = {**dict(list(self._begun.items())[-1:]), part.name: part.begun}
        yield from self._come(self.stream.add(part))

    def ended(self) -> Iterator[Event]:
        """Events of the last samples of a recording that has ended."""
        yield from self._come(self.stream.finish())

    def last_look(self) -> Iterator[Event]:
        """What has changed up to now, if that was not looked at yet."""
        state = self.state
        # motions in which something is the same, and others in which it is not
        if len(state.now) >= MIN_MOTIONS and state.now[-1].end > state.looked:
            yield from self._look_at_all()

    def _come(self, items: Iterable[Segment | Event]) -> Iterator[Event]:
        for item in items:
            if isinstance(item, Event):
                yield item
            # an arm at rest tells nothing of what moves it
            elif np.ptp(item.motion.q, axis=0).max() >= MOVED:
                yield from self._added(self._block(item))

    def learn_from(self, recordings: Iterable[Recording]) -> list[Event]:
        """Notes on recordings that are taken as normal, such as those of an earlier diagnosis.

        Raises:
            InputError: none of them has a torque and enough motion.
        """
        said = []
        for recording in recordings:
            self._begun = {recording.name: recording.begun}
            # each recording loses its ends, as in a diagnosis
            for item in (*self.stream.add(recording), *self.stream.finish()):
                if isinstance(item, Segment):
                    self.state.seen.append(self._block(item))
                else:
                    said.append(Event(NOTE, f"in what is learnt {item.sentence}"))
            # the next recording has zeros of its own
            self.stream.slipped = 0.0
        if len(self.state.seen) < MIN_BLOCKS:
            raise InputError(
                f"the case's recordings hold {len(self.state.seen) * BLOCK:.0f} s of motion with torque, "
                f"at least {MIN_BLOCKS * BLOCK:.0f} s are needed to learn from",
                "learn from the arm's own motion: --learn 60",
                where="--learn",
            )
        return [*said, self._learn()]

    def _block(self, segment: Segment) -> Block:
        """A segment on the clock of the stream, its torque without what effects of the arm are known to do."""
        motion, torque = segment.motion, segment.torque
        assert torque is not None
        arm = self.corrected
        if arm.effects or arm.residual or arm.remainder is not None:
            # what is found already gives way to the nominal arm: other effects are looked for
            body = segment.bodies(self._body)
            known = arm.unlimited.predict(body, motion)
            without = self._nominal.predict(body, motion)
            torque = arm.delivered(torque, motion) - known + without
        last = self.state.blocks[-1:]
        offset = 0.0
        if last:
            offset, before = last[0].offset, last[0].segment.recording
            # clocks of two recordings need not agree
            if before != segment.recording or motion.t[0] + offset < last[0].begin:
                offset = last[0].end + APART - float(motion.t[segment.inner][0])
        begun = self._begun.get(segment.recording, 0.0)
        on_clock = Motion(motion.t + offset, motion.q, motion.dq, motion.ddq)
        block = Block(replace(segment, motion=on_clock, torque=torque), offset, begun)
        if segment.temperature is not None:
            return replace(block, rested=segment.temperature[-1] - WARM)
        # what is estimated goes on from what was measured
        rested = last[0].rested if last else 0.0
        warmth = rested + self._warmed(block, last[0] if last else None)
        warm = replace(block.segment, temperature=warmth)
        return replace(block, segment=warm, rested=rested)

    def _warmed(self, block: Block, before: Block | None) -> np.ndarray:
        """How much warmer its own losses have made each joint [K], (N, n).

        COOLING dT/dt = WARM |dq| / USUAL_SPEED - T: losses of dry friction, which most are, go with the speed. An arm
        of which nothing is known is taken as warm: what fades slowly from there on is no alarm anyway.
        """
        motion = block.segment.motion
        speed = np.abs(motion.dq) / self.corrected.arm.per_radian
        since = np.zeros(len(motion.t))
        # at the start of a watch warm, else as at the end of the block before
        warm: np.ndarray | float = WARM
        if before is not None:
            assert before.segment.temperature is not None
            warm = before.segment.temperature[-1] - before.rested
            since = motion.t - before.segment.motion.t[-1]
            logged = block.begun - block.offset - before.begun + before.offset
            if block.begun and before.begun and before.offset != block.offset:
                # two recordings of which the logs say how long the arm has rested between them
                since = since + max(logged, 0.0)
            # windows overlap
            speed = speed * (since > 0)[:, None]
        # over a block of seconds heat adds up and hardly fades
        share = np.cumsum(speed, axis=0) / motion.rate / COOLING
        left = np.exp(-np.maximum(since, 0.0) / COOLING)[:, None]
        return warm * left + WARM / USUAL_SPEED * share

    def _added(self, block: Block) -> Iterator[Event]:
        state = self.state
        if not state.band:
            state.seen.append(block)
            if len(state.seen) >= self._wanted:
                yield self._learn()
            return
        # older motion is forgotten, block by block
        state.now = [*state.now, block][-round(NOW / BLOCK) :]
        # each span has some motion
        if len(state.now) >= SPANS and block.end >= state.looked + LOOK * state.pace:
            yield from self._look_at_all()

    def _look_at_all(self) -> Iterator[Event]:
        """The look at all that is compared."""
        self.state.looked = self.state.now[-1].end
        self._forget(self.state.now[0].begin)
        yield from self._look()

    def _forget(self, begin: float) -> None:
        """What changed before the motion that is compared may have any value like it all along."""
        state = self.state
        for (term, since), value in list(state.known.items()):
            # still within what is compared: it keeps its moment
            if since > begin:
                continue
            del state.known[term, since]
            # drifts count from what alarms have said already
            if called(term)[0] == PLAIN_FRICTION:
                state.said[term.joint - 1] += self._at_speed(term) * value[0]
            size, shares = np.abs(value), term.parametrisation.proportions
            # a load's first moment may be as large as its mass allows
            if shares is not None:
                size = np.maximum(size, size[0] * np.array(shares))
            state.free[term] = np.maximum(size, state.free.get(term, 0.0))

    def _learn(self) -> Event:
        """End of learning."""
        state = self.state
        # filters keep no more than the motions have
        state.band = min(TORQUE_CUTOFF, self.stream.cutoff or TORQUE_CUTOFF)
        self.prepare()
        last = state.seen[-1]
        # joints that rested have taught nothing: the user is told
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
        # what follows from the fit is kept from look to look
        self._holding, self._kept = rows.holding, Kept(self._about, {})
        first = Equations.of(design(rows, self._about, {}))
        self._taught = learn(first, (0,)), first

    def _rows(self, now: list[Block]) -> Rows:
        # blocks as they come: their columns are kept from look to look
        groups = [[[block.segment for block in self.state.seen]]]
        if now:
            groups.append([[block.segment for block in now]])
        rows = Rows(groups, self.state.band, len(groups))
        rows.follow_temperature()
        return rows

    def _whole(self) -> Rows:
        """All motion, blocks that follow each other in one segment."""
        groups = [[joined(self.state.seen)], [joined(self.state.now)]]
        rows = Rows(groups, self.state.band, len(groups))
        rows.follow_temperature()
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
        # columns of motion that is forgotten go with it
        for gone in parts.keys() - now:
            del parts[gone]
        rows.kept = self._kept
        learnt = Learnt(self._about, self._asked, state.free, self._taught, self._whole)
        said = changes_since(rows, state.known, learnt)
        # a single look may meet an odd motion, or a change too new to be told
        again = sorted(set(said.unknown) & set(state.unknown))
        state.unknown = dict(said.unknown)
        if said.changes is not None:
            yield from self._changed(said)
            return
        # nothing new is promised: back to the usual pace
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

    def _changed(self, said: Since) -> Iterator[Event]:
        """Alarms of what has changed, and that what took a while is over."""
        state, changes = self.state, said.changes or ()
        new = [change for change in changes if not self._is_known(change)]
        # known changes promise something again and again: each look costs a search
        state.pace = 1 if new else min(2 * state.pace, SLOWEST)
        # what is in the last samples alone may be a push
        if any(state.now[-1].end - change.time < SPAN / 2 for change in new):
            return
        likely: dict[Name, float] = {}
        for term, probability in said.others.items():
            # terms of one name are summed: which of them it is does not matter here
            name = called(term)
            likely[name] = min(likely.get(name, 0.0) + probability, 1.0)
        # a name needs to be likelier than all others together
        named = [one for one in new if likely[called(one.term)] >= NAMED]
        if new and not named:
            # something has changed, but no name is likely enough
            yield self._misfit([], min(change.time for change in new))
            return
        ended = [one for one in changes if self._is_over(one)]
        # values and moments of what is known are renewed with each look
        state.known = dict(said.steps)
        state.over |= {one.term: one.ends for one in ended}
        told = {called(change.term) for change in changes}
        others = {name: p for name, p in likely.items() if name not in told}
        # what is told as an alarm just now is not told as over as well
        ended = [one for one in ended if one not in named]
        for event, some in ((ALARM, named), (DRIFT, ended)):
            for finding in change_findings(some):
                name = finding["what"], tuple(finding["joints"])
                # friction as a whole, not a coefficient of it
                finding["probability"] = likely.get(name, finding["probability"])
                when = self._time(
                    finding["time"], finding["interval"], finding["until"]
                )
                sliding = self.corrected.arm.sliding
                yield alarm(finding, when, others, self._speed(), sliding, event)

    def _is_over(self, change: Change) -> bool:
        """Whether a change that took a while is over, and no drift has said so."""
        # near the end it may go on
        if change.until is None or self.state.now[-1].end - change.until < SPAN / 2:
            return False
        before = self.state.over.get(change.term, -np.inf)
        # a further stretch of the same drift is told, the same one is not
        return change.until - before >= SPAN

    def _is_known(self, change: Change) -> bool:
        # within a span, by which moments move from look to look
        end = change.time if change.until is None else change.until
        return any(
            called(term) == called(change.term)
            and change.time - SPAN < since < end + SPAN
            for term, since in self.state.known
        )

    def _misfit(self, joints: list[int], begun: float) -> Event:
        """The event of what has no name, after which all is learnt anew."""
        event = misfit(joints, self._time(begun))
        self._learn_anew(begun)
        return event

    def _learn_anew(self, begun: float) -> None:
        """What is like this from now on is normal."""
        # only motion after it: what was before would teach two states at once
        after = [block for block in self.state.now if block.begin >= begun]
        n = len(self.state.drift)
        self.state = State(np.zeros(n, dtype=int), np.zeros(n), after)
        self._about = self._kept = None

    def _drifted(self, fit: Fit) -> Iterator[Event]:
        """Notes on friction that has drifted by a further step."""
        state, about, made = self.state, self._about, fit.contrast.design
        assert about is not None
        # friction now, beside what was learnt: motion now is one group of the contrast
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
            # friction as it was learnt, at the usual speed
            level = at @ about.theta[[term.columns[0] for term in terms]]
            if level <= 0 or not all(own[-1, places]):
                # joints whose friction the motion does not show have no value
                continue
            # what alarms have named is no drift
            moved = per_column @ own[-1, places] - state.said[j]
            spread = fit.contrast.own_covariance(places)
            std = float(np.sqrt(per_column @ spread @ per_column))
            steps, before = int(moved / level / DRIFT_STEP), state.drift[j]
            # each step once, and again if it turns back
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

    def _time(
        self,
        begun: float,
        interval: tuple[float, float] | None = None,
        until: float | None = None,
    ) -> Time:
        """A moment on the clock of the stream by the clock of its recording, and when it was over."""
        blocks = self.state.blocks
        # the first block that lasts until then
        here = next((b for b in blocks if b.end >= begun), blocks[-1])
        name, offset = here.segment.recording, here.offset
        mine = [b for b in blocks if b.segment.recording == name]
        # what changed between two recordings shows from the first sample on
        begun = max(begun, mine[0].begin)
        last = blocks[-1]
        detected = last.end - offset
        if until is not None:
            # a change that goes on has no end yet
            goes_on = last.end - until < SPAN / 2
            until = detected if goes_on else until - offset
        if interval is not None:
            low, high = interval
            low, high = max(low, mine[0].begin), min(high, mine[-1].end)
            interval = low - offset, high - offset
        return Time(name, begun - offset, interval, detected, until)


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
    # there both are farthest from their ends, where filters are worst
    first, rest = t <= middle, further > middle
    if not same or further[0] > t[-1] or not (first.any() and rest.any()):
        return None
    # the grids of both are one
    if abs(further[rest][0] - t[first][-1] - step) > MIN_STEP * step:
        return None

    def both(one: Any, other: Any) -> np.ndarray:
        return np.concatenate([one[first], other[rest]])

    series = zip(vars(before.motion).values(), vars(after.motion).values(), strict=True)
    # ``measured`` is there for segments without unknown torque as well
    measured = both(before.measured, after.measured)
    return replace(
        before,
        motion=Motion(*(both(*pair) for pair in series)),
        torque=both(before.torque, after.torque),
        temperature=both(before.temperature, after.temperature),
        unknown=None if measured.all() else ~measured,
    )


# The state of a watch as one NPZ file, so that a later run goes on where this one ended.


STATE = "watch_state.npz"
"""Name of the file in the folder of the results."""
STATE_SCHEMA = 5
"""Version of its form."""


@dataclass(frozen=True)
class Saved:
    """What a watch leaves to a later run.

    Attributes:
        schema: version of its form.
        arm: fingerprint of what it was learnt about: with another arm it is worth nothing.
        source: its path.
        position: in the source.
        count: events that were written.
        cutoff, held, slipped: of the stream.
        state: of the detector.
    """

    schema: int
    arm: str
    source: str
    position: dict[str, Any]
    count: int
    cutoff: float | None
    held: Recording | None
    slipped: np.ndarray | float
    state: State


def save_state(
    file: Path,
    detector: Detector,
    arm: str,
    source: str,
    position: dict[str, Any],
    count: int,
) -> None:
    """Write a state whole or not at all.

    Raises:
        GapscopeError: the file cannot be written.
    """
    stream = detector.stream
    left = (stream.cutoff, stream.held, stream.slipped, detector.state)
    write_records(Saved(STATE_SCHEMA, arm, source, position, count, *left), file)


def load_state(file: Path, detector: Detector, arm: str) -> Saved | None:
    """Put a detector into the state of a file; ``None`` if it is of another arm or other settings.

    Raises:
        InputError: the file is no state of a watch.
    """
    types = (Saved, State, Block, Segment, Motion, KnownLoad, Recording, Term)
    try:
        found = read_records(file, types)
    except InputError as error:
        raise InputError(
            f"is no state of a watch ({error.problem})",
            "delete it: the watch then learns anew",
            file=file,
        ) from None
    # an earlier version wrote other records
    if not isinstance(found, Saved) or (found.schema, found.arm) != (STATE_SCHEMA, arm):
        return None
    stream = detector.stream
    stream.cutoff, stream.held, stream.slipped = found.cutoff, found.held, found.slipped
    detector.state = found.state
    # the arm that predicts is not saved: it follows from the motion
    if detector.state.band:
        detector.prepare()
    return found


# What a user chooses about a watch.


MIN_LEARNING = MIN_BLOCKS * BLOCK
"""Motion to learn from at least [s]."""


@dataclass(frozen=True)
class WatchSettings:
    """What a user chooses about a watch.

    Attributes:
        source: file or folder to follow.
        out: folder for alarms and state; ``None``: neither is written.
        learning: motion from which normal behaviour is learnt [s]; 0: the case's recordings show it.
        false_alarms: wanted per 24 h of motion at most, if the model had no errors.
        rest: time without a write after which a file is complete [s].
        until_idle: end when nothing new came for this long [s]; ``None``: never; 0: at once.

    Raises:
        InputError: a number is out of range.
    """

    source: Path
    out: Path | None = None
    learning: float = LEARN
    false_alarms: float = 0.1
    rest: float = 5.0
    until_idle: float | None = None

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name, value in (
            ("--learn", self.learning),
            ("--false-alarms", self.false_alarms),
            ("--rest", self.rest),
            ("--until-idle", self.until_idle or 0.0),
        ):
            # written so that nan is refused too
            if not 0.0 <= value < np.inf:
                raise InputError(
                    f"expected a number from 0 on, got {value:g}", where=name
                )
        if self.learning and self.learning < MIN_LEARNING:
            raise InputError(
                f"expected at least {MIN_LEARNING:g} s to learn from, or 0 for the case's recordings, "
                f"got {self.learning:g}",
                where="--learn",
            )
        if not self.false_alarms:
            raise InputError("expected a number above 0", where="--false-alarms")
