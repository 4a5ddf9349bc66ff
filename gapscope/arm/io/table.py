"""Tables of a log, and their rows that a log cannot mean."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import find_objects, label

from gapscope.arm.errors import InputError
from gapscope.arm.input_file import LARGEST_NUMBER
from gapscope.arm.nearest_name import shortened
from gapscope.arm.recording import MOST

# A table as a log file holds it: named columns, and the place of each row in the file.


GAP_STEPS = 4.0
"""A step of time longer than this many usual steps is a gap, over which nothing is interpolated [1]."""
NO_VALUE = ("", "nan", "-nan", "null", "none", "na", "n/a", "-", "[]")
"""What stands in a cell that has no value, in lower case."""


@dataclass(frozen=True)
class Table:
    """Columns of a log, not yet numbers.

    Attributes:
        path: the file, for messages.
        columns: cells per column name, N each: texts (CSV), numbers or lists; in the order of the file. A file without
            names calls them ``1``, ``2``, ...
        places: line of each row in a text file (the header is line 1), or number of the row, from 1, in others; (N,).
        place_kind: what ``places`` counts: ``line`` or ``row``.
        numbers_of_rows: number of each row in the file, from 0; ``None``: all of its rows.
        cut: what is wrong with rows that have too few cells or too many, by their places; their cells are ``None``.
        notes: what was noticed while reading.
        name: topic, group or episode that holds it; empty if the file is one table.
        kind: type of the messages, or the format of the file. The columns of ROS messages are named by field and joint,
            ``position[joint_1]`` or ``reference.positions[joint_1]``, beside ``t`` [s], the header's stamp.
    """

    path: Path
    columns: Mapping[str, Any]
    places: Sequence[int]
    place_kind: str = "row"
    numbers_of_rows: Sequence[int] | None = None
    cut: Mapping[int, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    name: str = ""
    kind: str = ""

    def __len__(self) -> int:
        """Number of rows N."""
        return len(self.places)

    @property
    def unnamed(self) -> bool:
        """Whether its columns are called by their numbers, for lack of names."""
        return all(name == str(j) for j, name in enumerate(self.columns, 1))

    def named(self, column: str) -> str:
        """Name of a column that is given by its name, or by its number in the file, from 1."""
        if column in self.columns or not column.isdecimal():
            return column
        return dict(enumerate(self.columns, 1)).get(int(column), column)

    def part(self, first: int, last: int) -> Table:
        """Rows ``first`` to ``last``, both included, counted from 0 below the header.

        Raises:
            InputError: the file has fewer rows.
        """
        if not first <= last < len(self):
            raise InputError(
                f"rows {first} to {last} were asked for, the file has rows 0 to {len(self) - 1}",
                "correct rows: in the import section",
                file=self.path,
            )
        return self.some(slice(first, last + 1))

    @property
    def row_numbers(self) -> Sequence[int]:
        """Number of each row in the file, from 0."""
        if self.numbers_of_rows is None:
            return range(len(self))
        return self.numbers_of_rows

    def some(self, rows: np.ndarray | slice) -> Table:
        """The rows of a mask, (N,), or of a slice."""

        def chosen(cells: Any) -> Any:
            # cells are arrays, lists or tuples, and rows a mask or a slice
            if isinstance(cells, np.ndarray) or isinstance(rows, slice):
                return cells[rows]
            return list(compress(cells, rows.tolist()))

        return replace(
            self,
            columns={name: chosen(cells) for name, cells in self.columns.items()},
            places=chosen(self.places),
            numbers_of_rows=chosen(self.row_numbers),
        )

    def where(self, row: int, column: str) -> str:
        """Place of a cell in the words of the user's file."""
        return f"{self.place_kind} {self.places[row]}, column {column}"

    def cells(self, column: str) -> Any:
        """Cells of one column as they were read.

        Raises:
            InputError: there is no such column.
        """
        column = self.named(column)
        if column not in self.columns:
            rename = "rename the column, or say in the case's import: section which column holds it"
            raise self.lacks(column, rename)
        return self.columns[column]

    def lacks(self, column: str, remedy: str) -> InputError:
        """The error on a column that is not there; ``remedy`` if the table has names of columns."""
        has = f"has no column {column}; it has {shortened(list(self.columns))}"
        if self.unnamed:
            has = f"has no header, and so no column {column}; it has {len(self.columns)} columns"
            remedy = (
                f"gapscope inspect {self.path.name} tells what they hold; a case's import: section takes their numbers "
                "from 1, as in time: 1, q: [2, 3]"
            )
        return InputError(has, remedy, file=self.path)

    def values(self, column: str) -> np.ndarray:
        """One column as numbers, (N,), or of lists, such as ``[0.1, 0.2]``, (N, L); nan where a cell is none."""
        cells = self.columns[column]
        # nearly all columns are numbers throughout: one call
        with suppress(ValueError, TypeError):
            found = np.asarray(cells, dtype=float)
            if len(found) == len(self):
                return found
        parsed = [_number(cell) for cell in cells]
        # the usual shape: a broken cell among lists of seven is none of them
        usual = Counter(x.shape for x in parsed if x.size != 1 or np.isfinite(x).all())
        shape = usual.most_common(1)[0][0] if usual else ()
        none = np.full(shape, np.nan)
        return np.array([x if x.shape == shape else none for x in parsed])

    def sizes(self, column: str) -> np.ndarray:
        """Size of each number of a column, or of the largest in each list, (N,); nan where none is."""
        values = self.values(column)
        return np.abs(values).reshape(len(values), -1).max(axis=1, initial=0.0)

    def numbers(self, column: str, length: int | None = None) -> np.ndarray:
        """One column as finite numbers, shape (N,), or of lists of a length, (N, length).

        Raises:
            InputError: the column is missing, or a cell is not a finite number, or not such a list.
        """
        self.cells(column)
        column = self.named(column)
        values = self.values(column)
        wanted = () if length is None else (length,)
        # so written that nan fails as well
        wrong = np.flatnonzero(~(self.sizes(column) <= LARGEST_NUMBER))
        # another width is wrong from the first row on
        if values.shape[1:] != wanted:
            wrong = np.arange(1)
        if not len(wrong):
            return values
        row = int(wrong[0])
        fault, remedy = self.fault(row, column), "drop or repair the row"
        if length is not None:
            cell = np.asarray(self.columns[column][row]).tolist()
            fault = f"expected a list of {length} numbers, one per joint, got {cell!r}"
            remedy = "name the recorded joints in joints:, in the order of the list"
        raise InputError(
            fault,
            f"{remedy}; a missing value is never guessed",
            file=self.path,
            where=self.where(row, column),
        )

    def fault(self, row: int, column: str) -> str:
        """What is wrong with a cell that is no number of an arm."""
        cell = self.columns[column][row]
        if cell is None or not str(cell).strip():
            return "the cell is empty"
        if is_number(cell):
            if np.isfinite(float(cell)):
                return f"holds {cell}, which no log of an arm does in any unit"
            return f"is not a finite number ({cell})"
        return f"expected a number, got {str(cell)[:40]!r}"


def _number(cell: Any) -> np.ndarray:
    """A number, (), or a list of numbers, (L,); nan if it is neither."""
    try:
        if isinstance(cell, str) and "[" in cell:
            cell = json.loads(cell)
        return np.asarray(cell, dtype=float)
    except (ValueError, TypeError):
        return np.array(np.nan)


def is_number(cell: Any) -> bool:
    """Whether a cell is a number, or a text that is one."""
    with suppress(ValueError, TypeError):
        float(cell)
        return True
    return False


def is_decimal(cell: str) -> bool:
    """Whether a text is a number, with a decimal point or a decimal comma."""
    return is_number(cell.replace(",", "."))


def table_of_columns(path: Path, columns: Mapping[str, Any], kind: str = "") -> Table:
    """Table of columns in memory.

    Raises:
        InputError: they have no rows, or differ in length.
    """
    lengths = {len(column) for column in columns.values()}
    if not lengths or not max(lengths):
        raise InputError("has no rows", "give a file with samples", file=path)
    if len(lengths) > 1:
        listed = [f"{name} {len(column)}" for name, column in columns.items()]
        raise InputError(
            f"its arrays differ in length: {', '.join(listed)}",
            "keep only arrays with one row per sample",
            file=path,
        )
    return Table(path, columns, range(1, max(lengths) + 1), kind=kind)


def numbered(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns ``q1..qn`` of arrays of shape (N, n) under their name, ``q``; those of one axis keep theirs."""
    columns: dict[str, np.ndarray] = {}
    for name, array in arrays.items():
        if array.ndim == 2:
            columns |= {f"{name}{j}": x for j, x in enumerate(array.T, start=1)}
        else:
            columns[name] = np.atleast_1d(array)
    return columns


def runs(mask: np.ndarray) -> list[slice]:
    """Each run of true values, one after the other, of a mask (N,)."""
    return [rows for (rows,) in find_objects(label(mask)[0])]


# What a reader of any format gives: the tables of a log, before anything is known of the arm that made it.


@dataclass(frozen=True)
class Log:
    """What is in a log.

    Attributes:
        path: file or folder.
        format: in words, ``CSV`` or ``ROS 2 bag (MCAP)``.
        tables: all that it holds. A topic whose messages name different joints, an arm's and a gripper's, gives a
            table for each set of joints.
        robot_description: URDF text, if the log holds one.
        notes: what was noticed while reading.
        unread: what it holds beside the tables, in words: topics of other types, arrays of another shape.
    """

    path: Path
    format: str
    tables: tuple[Table, ...]
    robot_description: str | None = None
    notes: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()

    @property
    def names(self) -> list[str]:
        """Names of the tables, each once."""
        return list(dict.fromkeys(table.name for table in self.tables))


# Rows that a log cannot mean: cut short, with text for a number, beyond any arm's numbers; and blocks without values.
#
# A few are left out with a note. A diagnosis loses nothing by it if ``MOST`` of the rows stay (``docs/data.md``);
# more are refused, all at once. A block without values is a pause of the log.


BEYOND = 1e12
"""Size of the largest number of a joint's quantity, in whatever unit [1]."""
NAMED = 3
"""Rows that a note or an error names."""
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
        faults: each says what is wrong with a row, or nothing.
    """

    bad: np.ndarray
    empty: np.ndarray
    faults: tuple[Callable[[int], str], ...] = ()

    def __or__(self, other: Damage) -> Damage:
        """That of both, row by row."""
        bad = self.bad | other.bad
        empty = (self.empty | other.empty) & ~bad
        # a row that is bad in one column is no pause, whatever it lacks in others
        return Damage(bad, empty, self.faults + other.faults)

    @property
    def sound(self) -> np.ndarray:
        """Rows to read, (N,)."""
        return ~(self.bad | self.empty)

    @cached_property
    def pauses(self) -> list[slice]:
        """Rows of each block without values, as many as make a gap in time."""
        blocks = runs(self.empty)
        return [rows for rows in blocks if rows.stop - rows.start >= GAP_STEPS]

    @property
    def scattered(self) -> np.ndarray:
        """Damaged rows beside the pauses, (N,)."""
        scattered = ~self.sound
        for rows in self.pauses:
            scattered[rows] = False
        return scattered

    @property
    def few(self) -> bool:
        """Whether most rows stay, pauses aside; one row may be broken in the shortest of logs."""
        count, total = self.scattered.sum(), len(self.bad)
        return bool(count <= 1 or total - count >= MOST * total)

    def notes(self, table: Table) -> tuple[str, ...]:
        """What was left out, in words.

        Raises:
            InputError: it is too much.
        """
        lost, pauses, scattered = ~self.sound, self.pauses, self.scattered
        total = len(lost)
        if not lost.any():
            return ()
        if lost.all() or not self.few:
            said = self._said(np.flatnonzero(lost).tolist())
            raise InputError(
                f"{lost.sum()} of {total} rows cannot be read: {said}",
                f"up to {1 - MOST:.0%} of the rows are left out; repair the file, or say null in the import: section "
                "for a channel that lacks values; a missing value is never guessed",
                file=table.path,
            )
        notes = []
        if count := int(scattered.sum()):
            said = self._said(np.flatnonzero(scattered).tolist())
            notes.append(f"{DAMAGED}{count} of {total} ({count / total:.2%}): {said}")
        if pauses:
            blocks = "1 block" if len(pauses) == 1 else f"{len(pauses)} blocks"
            said = self._said([rows.start for rows in pauses])
            notes.append(f"{PAUSE}{lost.sum() - count} of {total} in {blocks}: {said}")
        return tuple(notes)

    def _said(self, rows: Sequence[int]) -> str:
        """The first of some rows with what is wrong, and how many more there are."""
        named = [
            next(filter(None, (fault(row) for fault in self.faults)))
            for row in rows[:NAMED]
        ]
        more = len(rows) - len(named)
        return "; ".join([*named, *([f"and {more} more"] if more else [])])


def damage(table: Table, columns: Iterable[str], time: str | None = None) -> Damage:
    """What is wrong with the rows of a table in some of its columns, of numbers or of lists.

    Args:
        table: as a reader gave it.
        columns: of joints.
        time: the column of the time, whose numbers may be larger.
    """
    found = np.zeros((2, len(table)), dtype=bool)
    if table.cut:
        found[0] = [place in table.cut for place in table.places]
    wrong_in: dict[str, np.ndarray] = {}

    def fault(row: int) -> str:
        """That it is cut, or what is wrong in the first column in which anything is."""
        place = table.places[row]
        if place in table.cut:
            return f"{table.place_kind} {place} {table.cut[place]}"
        for column, wrong in wrong_in.items():
            if wrong[row]:
                return f"{table.where(row, column)}: {table.fault(row, column)}"
        return ""

    time = time and table.named(time)
    for column in [*filter(None, (time,)), *map(table.named, columns)]:
        if column not in table.columns:
            continue
        sizes = table.sizes(column)
        with np.errstate(invalid="ignore"):
            # stamps in nanoseconds are larger than any quantity of a joint
            wrong = ~(sizes <= (LARGEST_NUMBER if column == time else BEYOND))
        lacking = wrong & np.isnan(sizes)
        cells = table.columns[column]
        # an empty cell is a lack, a text is damage; an array of numbers has nan for both
        if not isinstance(cells, np.ndarray) or cells.dtype == object:
            texts = np.flatnonzero(lacking)
            said = ["" if cells[row] is None else str(cells[row]) for row in texts]
            lacking[texts] = [text.strip().lower() in NO_VALUE for text in said]
        found[0] |= wrong & ~lacking
        found[1] |= lacking
        if wrong.any():
            wrong_in[column] = wrong
    # a row that is cut lacks all values
    return Damage(found[0], found[1] & ~found[0], (fault,))


def without_damage(table: Table) -> Table:
    """A table of which nobody said yet what is read, without the rows that its columns of numbers cannot mean.

    Columns that lack more values than reading allows are left as they are, and so is the table if too many rows are
    damaged together.
    """
    none = np.zeros(len(table), dtype=bool)
    found = Damage(none, none)
    for column in table.columns:
        sizes = table.sizes(column)
        # stamps count nanoseconds
        large = np.isfinite(sizes).any() and np.nanmedian(sizes) > BEYOND
        own = damage(table, () if large else (column,), column if large else None)
        lost = ~own.sound
        # column by column: one that is empty throughout is no damage of the others
        if own.few and 2 * lost.sum() < len(table):
            found |= own
    # too many together: all rows stay, and the reader of a case will say so
    try:
        notes = found.notes(table)
    except InputError:
        return table
    if not notes:
        return table
    return replace(table.some(found.sound), notes=(*table.notes, *notes), cut={})
