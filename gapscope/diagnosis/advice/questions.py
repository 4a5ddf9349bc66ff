"""What a diagnosis leaves open: effects for which another would do as well."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gapscope.arm.display import effect_name
from gapscope.diagnosis.document.wording import acts_on
from gapscope.diagnosis.thresholds import DESIGNED_ALTERNATIVES, OPEN_ALTERNATIVE
from gapscope.effects.catalogue import explained


@dataclass(frozen=True)
class Question:
    """An effect found, and another that may replace it.

    Attributes:
        effect: name of the effect found.
        joints: its joints from 1; empty for the arm or a link.
        link: the joint that moves its link, or 0.
        rival: name of the other effect; ``none`` if there may be nothing in its place.
        rival_joints: its joints.
        probability: of the rival [1].
        found, other: both in words.
    """

    effect: str
    joints: tuple[int, ...]
    link: int
    rival: str
    rival_joints: tuple[int, ...]
    probability: float
    found: str
    other: str


def open_questions(document: Mapping[str, Any]) -> list[Question]:
    """The open questions of ``diagnosis.json``, the most probable rival first, at most ``DESIGNED_ALTERNATIVES``.

    No recording is designed for setup faults, which are not physics of the arm, nor for what a motion alone does not
    predict: how far a command exceeds a limit depends on the controller. None tells two names of one cause apart.
    """
    questions = []
    for entry in document["effects"]:
        for rival in entry["alternatives"]:
            if rival["probability"] >= OPEN_ALTERNATIVE and _designed(entry, rival):
                questions.append(_question(entry, rival))
    questions.sort(key=lambda question: -question.probability)
    return questions[:DESIGNED_ALTERNATIVES]


def _designed(entry: Mapping[str, Any], rival: Mapping[str, Any]) -> bool:
    """Whether a motion can be designed to separate two effects."""
    if rival.get("equivalent"):
        return False
    designed = {"none", *(e.name for e in explained() if not e.limits)}
    return {rival["effect"], entry["effect"]} <= designed


def _question(entry: Mapping[str, Any], rival: Mapping[str, Any]) -> Question:
    link = entry["parameters"].get("link")
    rival_joints = tuple(rival.get("joints") or ())
    return Question(
        effect=entry["effect"],
        joints=tuple(entry["joints"]),
        link=int(link["value"]) if link else 0,
        rival=rival["effect"],
        rival_joints=rival_joints,
        probability=rival["probability"],
        found=f"{effect_name(entry['effect'])} ({acts_on(entry)})",
        other=_words(rival["effect"], rival_joints),
    )


def _words(rival: str, joints: tuple[int, ...]) -> str:
    """A rival with what it acts on."""
    if rival == "none":
        return "no effect in its place"
    return (
        f"{effect_name(rival)} ({acts_on({'effect': rival, 'joints': list(joints)})})"
    )
