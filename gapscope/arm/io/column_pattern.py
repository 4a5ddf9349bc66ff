"""Patterns of column names: ``{j}`` is the joint's number from 1, ``{j0}`` that from 0, ``{joint}`` its name."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

_MARKS = {"{j}": r"(\d+)", "{j0}": r"(\d+)", "{joint}": r"(.+)"}


def has_mark(pattern: str) -> bool:
    """Whether a pattern names one column for each joint; else it names one whose cells hold lists."""
    return any(mark in pattern for mark in _MARKS)


def name_of(pattern: str, j: int, joint: str) -> str:
    """Name of the column of joint ``j``, from 0."""
    numbered = pattern.replace("{j}", str(j + 1)).replace("{j0}", str(j))
    return numbered.replace("{joint}", joint)


def joints_in(pattern: str, columns: Iterable[str]) -> list[str]:
    """What stands for the joint in the columns that follow a pattern: names, or numbers that count without a gap.

    >>> joints_in("q[{j0}]", ["q[0]", "q[1]", "q[3]"])
    ['0', '1']
    """
    mark = next((mark for mark in _MARKS if mark in pattern), None)
    if mark is None:
        return []
    before, after = pattern.split(mark, 1)
    expression = re.compile(re.escape(before) + _MARKS[mark] + re.escape(after))
    found = [m[1] for m in map(expression.fullmatch, columns) if m]
    if mark == "{joint}":
        return found
    return _counted(found, first=1 if mark == "{j}" else 0)


def _counted(numbers: Sequence[str], first: int) -> list[str]:
    """The numbers from the first on, as far as they follow each other."""
    counted: list[str] = []
    while str(first + len(counted)) in numbers:
        counted.append(str(first + len(counted)))
    return counted
