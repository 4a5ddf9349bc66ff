"""What page and terminal of an audit share: findings of a kind together, and sentences of its document."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gapscope.arm.display import MISSING

MOST_PLACES = 6
"""Most places that are named of findings of a kind."""


@dataclass(frozen=True)
class Group:
    """Findings of one severity and kind: the worst of them in full, and where the others are.

    Attributes:
        worst: the first of them.
        others: places and lines of the others, in words; empty if there are none.
    """

    worst: Mapping[str, Any]
    others: str


def groups(content: Mapping[str, Any]) -> list[Group]:
    """Findings by severity and kind, worst first."""
    together: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for finding in content["findings"]:
        together.setdefault((finding["severity"], finding["kind"]), []).append(finding)
    return [Group(found[0], _others(found[1:])) for found in together.values()]


def heading(content: Mapping[str, Any]) -> str:
    """How many findings of each severity, in one sentence."""
    counts = [f"{count} {name}" for name, count in content["counts"].items() if count]
    mass = content["total_mass"]
    size = f"{len(content['links'])} links, {_moving(content)} moving joints, {number(mass)} kg"
    return f"{size}: {', '.join(counts)}." if counts else f"{size}: nothing odd."


def place(finding: Mapping[str, Any]) -> str:
    """Link or joint with the line of the file."""
    line = f"line {finding['line']}" if finding["line"] else ""
    return ", ".join(part for part in (finding["place"], line) if part) or "whole file"


def number(value: float | None) -> str:
    """A number with three digits; a dash if there is none."""
    return MISSING if value is None else f"{value:.3g}"


def _moving(content: Mapping[str, Any]) -> int:
    return sum(one["kind"] in ("revolute", "prismatic") for one in content["joints"])


def _others(found: list[Mapping[str, Any]]) -> str:
    named = [place(one) for one in found[:MOST_PLACES]]
    rest = len(found) - len(named)
    return "; ".join([*named, f"{rest} more"] if rest else named)
