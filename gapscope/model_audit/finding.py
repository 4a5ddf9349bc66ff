"""One odd thing about a model."""

from __future__ import annotations

from dataclasses import dataclass

SEVERITIES = ("impossible", "implausible", "missing", "note")
"""From worst: no body or joint is like this; hardly any is; something that a simulation needs is not given; to know."""


@dataclass(frozen=True)
class Finding:
    """One odd thing about a model.

    Attributes:
        severity: one of ``SEVERITIES``.
        kind: what is odd, one word with underscores.
        place: the link or joint, or an empty string for the whole file.
        line: line of the element in the file, 0 for the whole file.
        found: what the file says, with numbers and units.
        expected: what is usual or possible.
        remedy: what to do.
        size: how far off, from 0; orders findings of one severity.
    """

    severity: str
    kind: str
    place: str
    line: int
    found: str
    expected: str
    remedy: str
    size: float = 0.0


def worst_first(findings: list[Finding]) -> tuple[Finding, ...]:
    """Findings by severity, then by size, then by line."""

    def key(one: Finding) -> tuple[int, float, int]:
        return SEVERITIES.index(one.severity), -one.size, one.line

    return tuple(sorted(findings, key=key))
