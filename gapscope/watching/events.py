"""What a watch can say: alarms, misfits and drifts, in words and as lines of a file."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gapscope.arm.display import effect_name
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.json_file import plain
from gapscope.arm.joint_units import joint_unit
from gapscope.effects.catalogue import of_quantity
from gapscope.model.changes import PAYLOAD, PLAIN_FRICTION

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
        effect: what changed: ``payload``, ``friction``, ``torque_offset``, ``encoder_offset`` or ``other``; empty for
            a note.
        change: in a word or two: ``picked up``, ``risen``; empty for a note.
        joints: from 1; empty for the whole arm.
        recording: in which it happened.
        time: when it began, in the recording's time [s]; ``None`` if it has none.
        interval: in which it began [s], or ``None``.
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


@dataclass(frozen=True)
class Slip:
    """An encoder that slipped: its reading jumped, and stays off.

    Attributes:
        recording: in which.
        before, after: times of the samples on both sides [s].
        joint: from 1.
        size, error: of the jump, and its standard deviation [rad or m].
    """

    recording: str
    before: float
    after: float
    joint: int
    size: float
    error: float


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
    interval: tuple[float, float]
    detected: float
    until: float | None = None

    @property
    def over(self) -> float | None:
        """When a change that took a while was over [s]; ``None`` if it was none, or is not."""
        return None if self.until is None or self.until >= self.detected else self.until

    @property
    def text(self) -> str:
        """``at 3.4 s of shift.csv``, ``from 3.4 to 9.1 s of shift.csv``."""
        if self.until is None:
            return f"at {self.begun:.1f} s of {self.recording}"
        if self.over is None:
            return f"little by little since {self.begun:.1f} s of {self.recording}, and goes on"
        return f"from {self.begun:.1f} to {self.over:.1f} s of {self.recording}"


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
    return _event(
        event,
        f"{text} {when.text}: {size_text}",
        when,
        effect=what,
        change=word.removeprefix("was ").removeprefix("has "),
        joints=joints,
        sizes=sizes,
        evidence={
            "probability": finding["probability"],
            "times_threshold": finding["times_threshold"],
        },
        alternatives=listed,
    )


def slipped(slip: Slip, sliding: Sequence[bool]) -> Event:
    """The alarm of an encoder whose reading jumped."""
    size = Size(slip.size, slip.error, joint_unit("rad", sliding[slip.joint - 1]))
    when = Time(slip.recording, slip.after, (slip.before, slip.after), slip.after)
    word = _direction(ENCODER, {"offset": size})
    text = f"{_in_words(ENCODER, [slip.joint])} {word} {when.text}"
    return _event(
        ALARM,
        f"{text}: its reading jumped by {size}",
        when,
        effect=ENCODER,
        change=word.removeprefix("has "),
        joints=[slip.joint],
        sizes={"offset": size},
    )


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
    return _nameless(ALARM, text, joints, when, evidence)


def misfit(joints: Sequence[int], when: Time) -> Event:
    """The model fits worse since some moment, and no cause explains it."""
    place = f" of joint {', '.join(map(str, joints))}" if joints else ""
    text = f"since {when.begun:.1f} s of {when.recording} the torque{place} fits the arm less well"
    text += ", and no single cause explains it: a motion that is new to the watch, or a change without a name"
    return _nameless(MISFIT, text, joints, when, {})


def _event(event: str, sentence: str, when: Time, **more: Any) -> Event:
    """An event at a moment."""
    return Event(
        event=event,
        sentence=sentence,
        recording=when.recording,
        time=when.begun,
        interval=when.interval,
        detected=when.detected,
        until=when.over,
        **more,
    )


def _nameless(
    event: str,
    sentence: str,
    joints: Sequence[int],
    when: Time,
    evidence: Mapping[str, float],
) -> Event:
    return _event(
        event,
        sentence,
        when,
        effect=OTHER,
        change="changed",
        joints=joints,
        evidence=evidence,
    )


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
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
        except OSError as error:
            raise self._cannot(error) from None

    def write(self, event: Event) -> None:
        """Append one line."""
        line = event.as_line(self.count + 1) + "\n"
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(line)
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise self._cannot(error) from None
        self.count += 1

    def _cannot(self, error: OSError) -> GapscopeError:
        return GapscopeError(
            f"{self.path}: cannot be written ({error.strerror})",
            "choose another folder, or check the permissions of this one",
        )
