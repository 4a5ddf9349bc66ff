"""Columns of a log that belong together: one number for each joint."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gapscope.arm.io.channel_entry import SIGN_BITS, with_sign
from gapscope.arm.io.table import Table
from gapscope.inspection.words import Meaning, meaning_of

_BRACKETED = re.compile(r"^.*\[(?P<label>[^\[\]]+)\][^\[\]]*$")
_FIELD = re.compile(r"^.*\[(?P<label>[^\[\].]+)\.(?P<field>[^\[\]]+)\]$")
_NUMBERED = re.compile(r"^.*?(?P<label>\d+)\D*$")
_DOTTED = re.compile(r"^(?P<label>[^.]+)\..+$")
"""Names of columns in which a joint stands in brackets, there before a quantity, is a number (the last), or stands
before a dot."""


SMOOTHER = 0.5
"""Share of its way that a series keeps if what seemed its leaps were a change of sign [1]. (hand)"""


BY_NAME = "by its name"
"""Reason for columns of which only the name tells the channel."""


@dataclass(frozen=True)
class ColumnGroup:
    """Columns with one number for each of k joints, or one column whose cells hold lists.

    Attributes:
        pattern: name with ``{j}`` (numbered from 1), ``{j0}`` (from 0) or ``{joint}`` in the place of what differs;
            the name itself of a column of lists, and of a single column.
        labels: what stands in that place, k texts; numbers from 1 for a column of lists.
        names: of the columns; one for a column of lists.
        values: (N, k); nan if a cell is empty or no number.
        seen: what their values show, of columns whose names tell nothing.
        holds: what these hold by that, in words that ``meaning_of`` knows; empty if names tell.
        sign_bit: bit of the numbers in the file that says the sign of these; ``None`` for ordinary numbers.
    """

    pattern: str
    labels: tuple[str, ...]
    names: tuple[str, ...]
    values: np.ndarray
    seen: str = ""
    holds: str = ""
    sign_bit: int | None = None

    @property
    def width(self) -> int:
        """Number of columns k, or of the entries of each list."""
        return self.values.shape[1]

    @property
    def numbered(self) -> bool:
        """Whether the columns have numbers in place of names."""
        return all(name.isdecimal() for name in self.names)

    def meaning(self, context: str) -> Meaning:
        """What they hold, by their values or their names; the name of file and topic counts if these are silent."""
        return meaning_of(self.holds or self.pattern, context)

    @property
    def by_name(self) -> bool:
        """Whether names of joints tell the columns apart."""
        return "{joint}" in self.pattern


@dataclass(frozen=True)
class TableColumns:
    """The columns of one table, sorted.

    Attributes:
        groups: one number for each joint.
        singles: other columns of numbers, (N,) each.
        texts: names of columns that hold no numbers.
    """

    groups: tuple[ColumnGroup, ...]
    singles: Mapping[str, np.ndarray]
    texts: tuple[str, ...]


def sorted_columns(table: Table, joints: Sequence[str] = ()) -> TableColumns:
    """Columns of a table as groups, single numbers and texts.

    Args:
        table: as a reader gave it.
        joints: names of joints that are known, which columns may carry.
    """
    numbers: dict[str, np.ndarray] = {}
    groups: list[ColumnGroup] = []
    texts = []
    for name, cells in table.columns.items():
        values = numbers_of(cells)
        if values is None:
            texts.append(name)
        elif values.ndim == 2:
            labels = tuple(str(k + 1) for k in range(values.shape[1]))
            groups.append(ColumnGroup(name, labels, (name,), values))
        else:
            numbers[name] = values
    for pattern, members in _patterns(list(numbers), joints).items():
        labels, names = tuple(members), tuple(members.values())
        values = np.column_stack([numbers.pop(name) for name in names])
        groups.append(ColumnGroup(_counted(pattern, labels), labels, names, values))
    return TableColumns(tuple(map(_signed, groups)), numbers, tuple(texts))


def _signed(group: ColumnGroup) -> ColumnGroup:
    """A group with its signs, if whole numbers run on through zero once a bit is read as the sign."""
    values = group.values
    if not np.isfinite(values).all() or (values < 0).any() or (values % 1).any():
        return group
    rough = np.abs(np.diff(values, axis=0)).sum()
    for bit in SIGN_BITS:
        if 2**bit <= values.max(initial=0) < 2 ** (bit + 1):
            read = with_sign(values, bit)
            if np.abs(np.diff(read, axis=0)).sum() < SMOOTHER * rough:
                return replace(group, values=read, sign_bit=bit)
    return group


def numbers_of(cells: Any) -> np.ndarray | None:
    """Cells as numbers, (N,), or (N, k) if they hold lists; ``None`` for texts."""
    first = next((cell for cell in cells if cell is not None and cell != ""), None)
    if isinstance(first, str) and first.lstrip().startswith("["):
        try:
            return _lists([json.loads(cell) for cell in cells])
        except ValueError:
            return None
    if isinstance(first, (list, tuple, np.ndarray)):
        return _lists(cells)
    try:
        return np.asarray(cells, dtype=float)
    except (ValueError, TypeError):
        pass
    parsed = np.array([_number(cell) for cell in cells])
    # a few empty or broken cells do not make a text of a column
    return parsed if np.isfinite(parsed).mean() > 0.5 else None


def _lists(cells: Any) -> np.ndarray | None:
    """Lists of one length as (N, k)."""
    lengths = {np.shape(cell) for cell in cells}
    if len(lengths) != 1 or len(next(iter(lengths))) != 1:
        return None
    return np.array([np.asarray(cell, dtype=float) for cell in cells])


def _number(cell: Any) -> float:
    try:
        return float(cell)
    except (ValueError, TypeError):
        return np.nan


def _patterns(names: Sequence[str], joints: Sequence[str]) -> dict[str, dict[str, str]]:
    """Names of columns by pattern, then by what stands in the place of ``{joint}``, if that differs among them."""
    readings = {name: _readings(name, joints) for name in names}
    counts = Counter(pattern for read in readings.values() for pattern, _ in read)
    found: dict[str, dict[str, str]] = {}
    for name, read in readings.items():
        # the pattern that most columns share; the first of several
        pattern, label = max(read, key=lambda r: counts[r[0]], default=("", ""))
        if counts[pattern] > 1 or label in joints:
            found.setdefault(pattern, {})[label] = name
    return {
        pattern: dict(sorted(members.items(), key=_by_number))
        for pattern, members in found.items()
    }


def _readings(name: str, joints: Sequence[str]) -> list[tuple[str, str]]:
    """Each way to read the name of a column as that of a joint's: pattern, and what stands for ``{joint}``."""
    # the longest first: joint_1 is a part of joint_10
    for joint in sorted(joints, key=len, reverse=True):
        if joint in name:
            return [(name.replace(joint, "{joint}", 1), joint)]
    field = _FIELD.match(name)
    if field and meaning_of(field["field"]).quantity:
        start, end = field.span("label")
        return [(f"{name[:start]}{{joint}}{name[end:]}", field["label"])]
    found = []
    for form in (_BRACKETED, _NUMBERED, _DOTTED):
        match = form.match(name)
        if match:
            start, end = match.span("label")
            found.append((f"{name[:start]}{{joint}}{name[end:]}", match["label"]))
    return found


def _by_number(member: tuple[str, str]) -> float:
    """Order of columns that are numbered; others keep the file's."""
    return int(member[0]) if member[0].isdigit() else 0


def _counted(pattern: str, labels: tuple[str, ...]) -> str:
    """The pattern with ``{j}`` or ``{j0}`` if the labels are numbers that count from 1 or 0."""
    for first, place in ((1, "{j}"), (0, "{j0}")):
        if labels == tuple(str(first + k) for k in range(len(labels))):
            return pattern.replace("{joint}", place)
    return pattern
