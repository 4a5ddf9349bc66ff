"""What table and page of an agreement share: numbers and sentences of its document."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from gapscope.arm.display import MISSING, display_unit, uncertain

Line = Mapping[str, Any]

RELATIVE = "Friction is that of each recording; all else counts from the first one."
"""What is to be known of the values."""


def heading(content: Line) -> str:
    """How many parameters agree, differ and are not determined, in one sentence."""
    verdicts = [line["verdict"] for line in content["parameters"]]
    counts = {name: verdicts.count(name) for name in ("agrees", "differs")}
    text = (
        f"{len(content['recordings'])} recordings, {len(verdicts)} parameters: {counts['agrees']} agree, "
        f"{counts['differs']} differ"
    )
    rest = len(verdicts) - sum(counts.values())
    return f"{text}, {rest} not determined by two recordings." if rest else f"{text}."


def with_unit(value: str, line: Line) -> str:
    """A value as text with its unit; a dash stays alone."""
    return value if value == MISSING else f"{value} {unit(line)}".rstrip()


def differing(content: Line) -> list[Line]:
    """Parameters that differ, the strongest first."""
    return [line for line in content["parameters"] if line["verdict"] == "differs"]


def trusted(line: Line) -> str:
    """The value to trust, with its deviation."""
    value = line["trusted"]
    return MISSING if value is None else uncertain(value["value"], value["std"])


def values(line: Line) -> list[str]:
    """The value in each recording; a dash if it does not determine the parameter."""
    pairs = zip(line["values"], line["std"], strict=True)
    return [MISSING if std is None else uncertain(x, std) for x, std in pairs]


def unit(line: Line) -> str:
    """Unit of the values as it is shown; empty for a ratio."""
    return "" if line["unit"] == "1" else display_unit(line["unit"], 1.0)[1]


def undetermined(line: Line, recordings: list[str]) -> list[str]:
    """Recordings that do not determine a parameter."""
    pairs = zip(recordings, line["information"], strict=True)
    return [name for name, ratio in pairs if ratio < 1.0]


def sentences(line: Line) -> Iterator[str]:
    """What a difference goes with, what would settle it, and what it may be instead."""
    yield f"goes with: {line['goes_with']['text']}"
    yield f"to settle it: {line['settled_by']}"
    if line["alternatives"]:
        yield f"may as well be: {', '.join(line['alternatives'])}"
