"""Rows that a log cannot mean: cut short, with text for a number, beyond any arm's numbers; and blocks without values.

A few are left out with a note. Up to ``MAX_DAMAGED`` of the rows a diagnosis loses nothing by it (``docs/data.md``);
more are refused, all at once. A block without values is a pause of the log.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.io.table import LARGEST_NUMBER, Table

BEYOND = 1e12
"""Size of the largest number of a joint's quantity, in whatever unit [1]."""
MAX_DAMAGED = 0.1
"""Share of the rows up to which they are left out [1]: diagnoses of recordings that lost as many have been right."""
BLOCK = 4
"""So many rows without values, one after the other, are a pause [1]: longer steps of time are cut."""
NAMED = 3
"""Rows that a note or an error names."""
FORMULATED = 1000
"""Cells of each column of which it is said what is wrong, for lack of memory."""
DAMAGED = "rows left out that cannot be read: "
"""Note on them; their number, share and places follow."""
PAUSE = "rows without values left out as pauses: "
"""Note on blocks of them; their number follows."""


@dataclass(frozen=True)
class Damage:
    """What is wrong with the rows of a table, or of several side by side, (N,) each.

    Attributes:
        bad: rows that are cut, or hold what is no number of an arm.
        empty: rows that are whole and lack a value.
        first: what is wrong with the first of them, by row.
    """

    bad: np.ndarray
    empty: np.ndarray
    first: Mapping[int, str]

    def __or__(self, other: Damage) -> Damage:
        """That of both, row by row."""
        bad = self.bad | other.bad
        first = {**other.first, **self.first}
        return Damage(bad, (self.empty | other.empty) & ~bad, first)

    @property
    def sound(self) -> np.ndarray:
        """Rows to read, (N,)."""
        return ~(self.bad | self.empty)

    @cached_property
    def pauses(self) -> list[np.ndarray]:
        """Rows of each block without values."""
        edges = np.flatnonzero(np.diff(np.r_[False, self.empty, False]))
        ends = zip(edges[::2], edges[1::2], strict=True)
        return [np.arange(*pair) for pair in ends if pair[1] - pair[0] >= BLOCK]

    @property
    def scattered(self) -> np.ndarray:
        """Damaged rows beside the pauses, (N,)."""
        scattered = ~self.sound
        for rows in self.pauses:
            scattered[rows] = False
        return scattered

    def notes(self, table: Table) -> tuple[str, ...]:
        """What was left out, in words.

        Raises:
            InputError: it is too much.
        """
        if self.sound.all():
            return ()
        pauses, scattered = self.pauses, self.scattered
        count, total = int(scattered.sum()), len(scattered)
        if count > max(1, MAX_DAMAGED * total) or not self.sound.any():
            raise self._error(table)
        notes = []
        if count:
            said = self._said(np.flatnonzero(scattered))
            notes.append(f"{DAMAGED}{count} of {total} ({count / total:.2%}): {said}")
        if pauses:
            lost = sum(map(len, pauses))
            blocks = "1 block" if len(pauses) == 1 else f"{len(pauses)} blocks"
            said = self._said([int(rows[0]) for rows in pauses])
            notes.append(f"{PAUSE}{lost} of {total} in {blocks}: {said}")
        return tuple(notes)

    def _said(self, rows: Iterable[int]) -> str:
        """The first of some rows with what is wrong, and how many more there are."""
        rows = list(rows)
        named = [self.first[int(row)] for row in rows[:NAMED] if int(row) in self.first]
        more = len(rows) - len(named)
        return "; ".join([*named, *([f"and {more} more"] if more else [])])

    def _error(self, table: Table) -> InputError:
        wrong = np.flatnonzero(~self.sound)
        cells = [self.first[int(row)] for row in wrong[:1] if int(row) in self.first]
        remedy = (
            f"up to {MAX_DAMAGED:.0%} of the rows are left out; repair the file, or say null in the import: section "
            "for a channel that lacks values; a missing value is never guessed"
        )
        if any("decimal comma" in text for text in cells):
            remedy = "write decimal points"
        return InputError(
            f"{len(wrong)} of {len(self.bad)} rows cannot be read: {self._said(wrong)}",
            remedy,
            file=table.path,
        )


def damage(table: Table, columns: Iterable[str], time: str | None = None) -> Damage:
    """What is wrong with the rows of a table in some of its columns, of numbers or of lists.

    Args:
        table: as a reader gave it.
        columns: of joints.
        time: the column of the time, whose numbers may be larger.
    """
    found = np.zeros((2, len(table)), dtype=bool)
    first: dict[int, str] = {}
    lines = {place: row for row, place in enumerate(table.places)} if table.cut else {}
    for place, text in table.cut.items():
        if place in lines:
            found[0, lines[place]] = True
            first[lines[place]] = f"{table.place_kind} {place} {text}"
    time = time and table.named(time)
    for column in [*filter(None, (time,)), *map(table.named, columns)]:
        if column not in table.columns:
            continue
        values = table.loose(column)
        largest = LARGEST_NUMBER if column == time else BEYOND
        with np.errstate(invalid="ignore"):
            wrong = ~(np.abs(values) <= largest)
        lacking = wrong & np.isnan(values)
        if not isinstance(table.columns[column], np.ndarray):
            texts = np.flatnonzero(lacking)
            lacking[texts] = [table.is_empty(row, column) for row in texts]
        found[0] |= wrong & ~lacking
        found[1] |= lacking
        for row in np.flatnonzero(wrong)[:FORMULATED].tolist():
            if row not in first:
                first[row] = f"{table.where(row, column)}: {table.fault(row, column)}"
    # a row that is cut lacks all values
    return Damage(found[0], found[1] & ~found[0], first)


def without_damage(table: Table) -> Table:
    """A table of which nobody said yet what is read, without the rows that its columns of numbers cannot mean.

    Columns that lack more values than reading allows are left as they are, and so is the table if too many rows are
    damaged together.
    """
    none = np.zeros(len(table), dtype=bool)
    found = Damage(none, none, {})
    for column in table.columns:
        values = table.loose(column)
        # stamps count nanoseconds
        large = np.isfinite(values).any() and np.nanmedian(np.abs(values)) > BEYOND
        own = damage(table, () if large else (column,), column if large else None)
        lost = ~own.sound
        few = own.scattered.sum() <= max(1, MAX_DAMAGED * len(table))
        if few and 2 * lost.sum() < len(table):
            found |= own
    try:
        notes = found.notes(table)
    except InputError:
        return table
    if not notes:
        return table
    return replace(table.some(found.sound), notes=(*table.notes, *notes), cut={})
