"""Effects that recordings cannot separate, declared before any run; scores are given strictly and modulo these."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Named:
    """An effect that is named, by a label or a diagnosis.

    Attributes:
        effect: its name.
        joints: its joints, from 1; empty for the arm or a link.
        link: the link of ``link_inertia``, from 1; 0 for others.
    """

    effect: str
    joints: tuple[int, ...] = ()
    link: int = 0


@dataclass(frozen=True)
class Declared:
    """A pair of effects that count as the same under a condition.

    Attributes:
        first, second: names.
        when: the condition, in words.
        why: the reason.
    """

    first: str
    second: str
    when: str
    why: str


CLASSES = (
    Declared(
        "actuator_delay",
        "actuator_lag",
        "no recording that was given moves above 3 Hz",
        "both delay the torque by the same time there; cosine of the signatures 1.00",
    ),
    Declared(
        "armature",
        "link_inertia",
        "the armature acts on joints 1 or 2 only",
        "the same base parameters, exactly",
    ),
    Declared(
        "payload", "link_inertia", "the link is the last one", "the same body, exactly"
    ),
)
"""The classes."""

FAST = "fast"
"""The kind of motion that moves above 3 Hz."""


def named(entry: dict[str, Any]) -> Named:
    """An entry of ``effects`` of a label or a diagnosis."""
    link: Any = 0
    if entry["effect"] == "link_inertia":
        link = entry.get("parameters", {}).get("link", {}).get("value", 0)
    if isinstance(link, list):
        link = link[0]
    return Named(entry["effect"], tuple(entry["joints"]), int(link))


def same(one: Named, other: Named, n_joints: int, motions: Sequence[str]) -> bool:
    """Whether two effects count as the same modulo the classes.

    Args:
        one, other: what is named.
        n_joints: joints of the arm.
        motions: kinds of the recordings that the diagnosis was given.
    """
    if one.effect == other.effect:
        return True
    pair = {one.effect: one, other.effect: other}
    if set(pair) == {"actuator_delay", "actuator_lag"}:
        return FAST not in motions
    if set(pair) == {"armature", "link_inertia"}:
        return max(pair["armature"].joints, default=9) <= 2
    if set(pair) == {"payload", "link_inertia"}:
        return pair["link_inertia"].link == n_joints
    return False


def matched(
    truth: Sequence[Named], found: Sequence[Named], n: int, motions: Sequence[str]
) -> list[tuple[int, int]]:
    """Pairs (place in truth, place in found) of effects that count as the same, each used once, equal names first."""
    pairs = [(i, j) for i in range(len(truth)) for j in range(len(found))]
    # equal names first, so that a class never takes an effect away from its own name
    pairs.sort(key=lambda pair: truth[pair[0]].effect != found[pair[1]].effect)
    out: list[tuple[int, int]] = []
    for i, j in pairs:
        used = any(i == a or j == b for a, b in out)
        if not used and same(truth[i], found[j], n, motions):
            out.append((i, j))
    return out


def strict(truth: Iterable[Named], found: Iterable[Named]) -> bool:
    """Whether the same names are in both, classes aside."""
    return sorted(x.effect for x in truth) == sorted(x.effect for x in found)
