"""Units of ``diagnosis.json`` on an arm with sliding joints: m, N and kg where an entry is about a slide."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from gapscope.arm.joint_units import SLIDING_UNITS, common_unit, joint_unit, units_of

_LONGEST_FIRST = sorted(SLIDING_UNITS, key=len, reverse=True)
_IN_TEXT = re.compile(
    r"(?<![\w/])(" + "|".join(map(re.escape, _LONGEST_FIRST)) + r")(?![\w/²^])"
)
"""A unit with an angle in a text."""


def with_slide_units(content: dict[str, Any], sliding: Sequence[bool]) -> Any:
    """The document with the units of slides; as it is for an arm whose joints all turn.

    An entry with ``joint`` or ``joints`` is about those, and so is what it holds. A parameter of joints of both kinds
    has both units in ``unit``, and one for each value in ``units``.
    """
    if not any(sliding):
        return content
    return _converted(content, sliding, ())


def _converted(node: Any, sliding: Sequence[bool], about: Sequence[bool]) -> Any:
    """A part of the document, about joints that slide or turn."""
    if isinstance(node, list):
        return [_converted(each, sliding, about) for each in node]
    if isinstance(node, str):
        return in_text(node) if about and all(about) else node
    if not isinstance(node, Mapping):
        return node
    about = _about(node, sliding) or about
    out = {
        key: value if key == "unit" else _converted(value, sliding, about)
        for key, value in node.items()
    }
    if isinstance(unit := node.get("unit"), str) and any(about):
        out["unit"] = common_unit(unit, about)
        if not all(about) and joint_unit(unit, True) != unit:
            out["units"] = units_of(unit, about)
    return out


def _about(node: Mapping[str, Any], sliding: Sequence[bool]) -> tuple[bool, ...]:
    """Which of the joints that an entry names slide; empty if it names none."""
    joints = node.get("joints", node.get("joint"))
    numbers = [joints] if isinstance(joints, int) else joints or []
    if not all(isinstance(number, int) for number in numbers):
        return ()
    return tuple(bool(sliding[number - 1]) for number in numbers)


def in_text(text: str) -> str:
    """A text about a slide with its units."""
    return _IN_TEXT.sub(lambda match: joint_unit(match[1], True), text)
