"""A candidate as an alarm: its name, its sizes with errors, and the sentence for a reader."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gapscope.arm.joint_units import joint_unit
from gapscope.effects.catalogue import effect
from gapscope.model.change_findings import PAYLOAD
from gapscope.watching.alarm import ALARM, DRIFT, MISFIT, Event, Size
from gapscope.watching.detection.change_test import Candidate
from gapscope.watching.detection.hypotheses import (
    ENCODER,
    FRICTION,
    OFFSET,
    OTHER,
)
from gapscope.watching.detection.learning import Moment, Normal
from gapscope.watching.detection.watched_arm import WatchedArm
from gapscope.watching.thresholds import NAMED_SURE

WORDS = {
    PAYLOAD: ("a load was {}", "picked up", "put down"),
    FRICTION: ("the friction of joint {joint} has {}", "risen", "fallen"),
    OFFSET: ("the torque offset of joint {joint} has {}", "risen", "fallen"),
    ENCODER: ("the encoder's zero of joint {joint} has {}", "risen", "fallen"),
}
"""Sentence of each effect, and its words for an increase and a decrease."""


def named_alarm(
    candidate: Candidate,
    sizes: dict[str, Size],
    when: tuple[Moment, Moment, Moment],
    evidence: dict[str, float],
    alternatives: Sequence[Candidate],
) -> Event:
    """The alarm of a change that has a name.

    Args:
        candidate: the change.
        sizes: of it, the one that decides on its direction first.
        when: the blocks between which it began, and the last one.
        evidence: numbers that led to it.
        alternatives: others that are nearly as likely.
    """
    change = candidate.change
    assert change is not None
    main = next(iter(sizes.values()))
    text, up, down = WORDS[change.effect]
    word = up if main.value > 0 else down
    sentence = text.format(word, joint=change.joint)
    listed = [_alternative(other) for other in alternatives]
    if listed:
        names = ", or ".join(_in_words(entry) for entry in listed)
        sentence = f"{sentence}, or it is {names}"
    low, begun, last = when
    size_text = ", ".join(f"{name} {size}" for name, size in sizes.items())
    return Event(
        event=ALARM,
        sentence=f"{sentence} {_place(begun)}: {size_text}",
        effect=change.effect,
        change=word,
        joints=change.joints,
        recording=begun.recording,
        time=begun.start,
        interval=_interval(low, begun),
        detected=last.end,
        sizes=sizes,
        evidence=evidence,
        alternatives=listed,
    )


def noise_alarm(
    joints: Sequence[int],
    what: str,
    when: tuple[Moment, Moment, Moment],
    evidence: dict[str, float],
) -> Event:
    """The alarm of joints that leave more torque than any parameter explains.

    Args:
        joints: on which it shows, from 1.
        what: shows, in words.
        when: the blocks between which it began, and the last one.
        evidence: numbers that led to it.
    """
    place = f"on joint {', '.join(map(str, joints))}"
    text = f"something else changed {place} {_place(when[1])}: {what}"
    return _nameless(ALARM, text, joints, when, evidence)


def misfit(when: tuple[Moment, Moment, Moment], evidence: dict[str, float]) -> Event:
    """The model fits worse since some moment, and no single cause explains it.

    Args:
        when: the blocks between which it began, and the last one.
        evidence: numbers that led to it.
    """
    text = f"since {when[1].start:.1f} s of {when[1].recording} the torque fits the arm less well"
    text += ", and no single cause explains it: a motion that is new to the watch, or a change without a name"
    return _nameless(MISFIT, text, (), when, evidence)


def _nameless(
    event: str,
    sentence: str,
    joints: Sequence[int],
    when: tuple[Moment, Moment, Moment],
    evidence: dict[str, float],
) -> Event:
    low, begun, last = when
    return Event(
        event=event,
        sentence=sentence,
        effect=OTHER,
        change="changed",
        joints=joints,
        recording=begun.recording,
        time=begun.start,
        interval=_interval(low, begun),
        detected=last.end,
        evidence=evidence,
    )


def drift_note(joint: int, size: Size, share: float, last: Moment) -> Event:
    """Friction of a joint that drifted slowly by a share of what it was."""
    word = "risen" if share > 0 else "fallen"
    text = f"the friction of joint {joint} has slowly {word} by {abs(share):.0%} since it was learnt: {size}"
    return Event(
        event=DRIFT,
        sentence=f"{text} (at {last.end:.1f} s of {last.recording})",
        effect=FRICTION,
        change=word,
        joints=[joint],
        recording=last.recording,
        time=None,
        detected=last.end,
        sizes={"torque": size},
        evidence={"share": share},
    )


def is_sure(sizes: dict[str, Size]) -> bool:
    """Whether the first of the sizes differs clearly from zero."""
    main = next(iter(sizes.values()))
    return abs(main.value) > NAMED_SURE * main.std


def sizes_of(candidate: Candidate, arm: WatchedArm, normal: Normal) -> dict[str, Size]:
    """Sizes of a change by name, the one that decides on its direction first."""
    change, fit = candidate.change, candidate.fit
    assert change is not None and fit is not None
    std = np.sqrt(np.diag(fit.covariance).clip(0.0))
    if change.effect == PAYLOAD:
        names: tuple[str, ...] = (
            "mass",
            "first_moment_x",
            "first_moment_y",
            "first_moment_z",
        )
        units: tuple[str, ...] = ("kg", "kg m", "kg m", "kg m")
        return _listed(names, fit.size, std, units)
    assert change.joint is not None
    slides = arm.arm.sliding[change.joint - 1]
    if change.effect == FRICTION:
        # torque at the usual speed, which both coefficients make up
        speed = float(normal.scales.speed[change.joint - 1])
        at_speed = np.array([speed, 1.0])
        torque = float(at_speed @ fit.size)
        error = float(np.sqrt(max(at_speed @ fit.covariance @ at_speed, 0.0)))
        units = tuple(joint_unit(u, slides) for u in ("N m", "N m s/rad", "N m"))
        values = np.r_[torque, fit.size]
        names = ("torque_at_usual_speed", "viscous", "coulomb")
        return _listed(names, values, np.r_[error, std], units)
    unit = joint_unit(effect(change.effect).parameters[0].unit, slides)
    return _listed(("offset",), fit.size, std, (unit,))


def _listed(
    names: Sequence[str], values: np.ndarray, stds: np.ndarray, units: Sequence[str]
) -> dict[str, Size]:
    rows = zip(names, values, stds, units, strict=True)
    return {
        name: Size(float(value), float(std), unit) for name, value, std, unit in rows
    }


def _alternative(candidate: Candidate) -> dict[str, object]:
    change = candidate.change
    assert change is not None
    return {
        "effect": change.effect,
        "joints": change.joints,
        "evidence": candidate.evidence,
    }


def _in_words(entry: dict[str, object]) -> str:
    effect = str(entry["effect"]).replace("_", " ")
    joints = entry["joints"]
    assert isinstance(joints, list)
    return f"{effect} of joint {joints[0]}" if joints else effect


def _place(moment: Moment) -> str:
    return f"at {moment.start:.1f} s of {moment.recording}"


def _interval(low: Moment, begun: Moment) -> tuple[float, float]:
    """Between which times it began; within one recording."""
    start = low.start if low.recording == begun.recording else begun.start
    return (start, begun.end)
