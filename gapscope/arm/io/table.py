"""Tables of a log: rows at even times, arrays, parts of recordings."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.errors import InputError

# A table as a log file holds it: named columns, and the place of each row in the file.


LARGEST_NUMBER = 1e50
"""Size of the largest number in a log, whatever it counts; squares and products of larger ones overflow [1]."""
NO_VALUE = ("", "nan", "-nan", "null", "none", "na", "n/a", "-")
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
    """

    path: Path
    columns: Mapping[str, Any]
    places: Sequence[int]
    place_kind: str = "row"
    numbers_of_rows: Sequence[int] | None = None
    cut: Mapping[int, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Number of rows N."""
        return len(self.places)

    @property
    def unnamed(self) -> bool:
        """Whether its columns are called by their numbers, for lack of names."""
        return list(self.columns) == [str(j + 1) for j in range(len(self.columns))]

    def named(self, column: str) -> str:
        """Name of a column that is given by its name, or by its number in the file, from 1."""
        if column in self.columns or not column.isdecimal():
            return column
        return dict(enumerate(self.columns, start=1)).get(int(column), column)

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
        cut = slice(first, last + 1)
        columns = {name: cells[cut] for name, cells in self.columns.items()}
        rows = self.row_numbers[cut]
        return replace(
            self, columns=columns, places=self.places[cut], numbers_of_rows=rows
        )

    @property
    def row_numbers(self) -> Sequence[int]:
        """Number of each row in the file, from 0."""
        if self.numbers_of_rows is None:
            return range(len(self))
        return self.numbers_of_rows

    def some(self, rows: np.ndarray) -> Table:
        """The rows of a mask, (N,)."""
        places = np.flatnonzero(rows).tolist()
        columns = {
            name: cells[rows]
            if isinstance(cells, np.ndarray)
            else [cells[place] for place in places]
            for name, cells in self.columns.items()
        }
        return replace(
            self,
            columns=columns,
            places=[self.places[place] for place in places],
            numbers_of_rows=[self.row_numbers[place] for place in places],
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

    def numbers(self, column: str) -> np.ndarray:
        """One column as finite numbers, shape (N,).

        Raises:
            InputError: the column is missing, or a cell is not a finite number.
        """
        cells, column = self.cells(column), self.named(column)
        try:
            values = np.asarray(cells, dtype=float)
        except (ValueError, TypeError):
            bad = [row for row, cell in enumerate(cells) if not _is_number(cell)]
            raise self._not_a_number(bad[0], column, cells[bad[0]]) from None
        self._check_finite(values[:, None], column)
        return values

    def lists(self, column: str, length: int) -> np.ndarray:
        """One column whose cells hold lists, such as ``[0.1, 0.2]``, as finite numbers, shape (N, length).

        Raises:
            InputError: the column is missing, or a cell is not a list of ``length`` finite numbers.
        """
        rows, cells, column = [], self.cells(column), self.named(column)
        for row, cell in enumerate(cells):
            try:
                numbers = json.loads(cell) if isinstance(cell, str) else cell
                value = np.asarray(numbers, dtype=float)
            except (ValueError, TypeError):
                raise self._not_a_number(row, column, cell) from None
            if value.shape != (length,):
                raise InputError(
                    f"expected a list of {length} numbers, one per joint, got {cell!r}",
                    "name the recorded joints in joints:, in the order of the list",
                    file=self.path,
                    where=self.where(row, column),
                )
            rows.append(value)
        values = np.array(rows)
        self._check_finite(values, column)
        return values

    def loose(self, column: str) -> np.ndarray:
        """One column as numbers, (N,), nan where a cell is none; of lists the size of the largest entry."""
        cells = self.columns[column]
        try:
            values = np.asarray(cells, dtype=float)
        except (ValueError, TypeError):
            values = np.empty(0)
        if values.ndim == 1 and len(values) == len(self):
            return values
        sizes = [_list_size(cell) for cell in cells]
        usual = np.median([length for length, _ in sizes if length] or [0])
        return np.array([x if length == usual else np.nan for length, x in sizes])

    def is_empty(self, row: int, column: str) -> bool:
        """Whether a cell says that there is no value."""
        cell = self.columns[column][row]
        return cell is None or str(cell).strip().lower() in NO_VALUE

    def fault(self, row: int, column: str) -> str:
        """What is wrong with a cell that is no number of an arm."""
        cell = self.columns[column][row]
        if not _is_number(cell):
            return self._not_a_number(row, column, cell).problem
        if np.isfinite(float(cell)):
            return f"holds {cell}, which no log of an arm does in any unit"
        return f"is not a finite number ({cell})"

    def _check_finite(self, values: np.ndarray, column: str) -> None:
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if len(bad):
            raise InputError(
                f"is not a finite number ({self.columns[column][bad[0]]}), the first of {len(bad)} in this column",
                "drop the row (a gap in time is understood) or repair it; a missing value is never guessed",
                file=self.path,
                where=self.where(int(bad[0]), column),
            )
        large = np.flatnonzero((np.abs(values) > LARGEST_NUMBER).any(axis=1))
        if len(large):
            raise InputError(
                f"holds {self.columns[column][large[0]]}, which no log of an arm does in any unit",
                "drop or repair the row",
                file=self.path,
                where=self.where(int(large[0]), column),
            )

    def _not_a_number(self, row: int, column: str, cell: Any) -> InputError:
        if cell is None or not str(cell).strip():
            message, remedy = (
                "the cell is empty",
                "drop the row or fill it in; a missing value is never guessed",
            )
        elif isinstance(cell, str) and _is_number(cell.replace(",", ".")):
            message, remedy = f"{cell!r} has a decimal comma", "write decimal points"
        else:
            message, remedy = (
                f"expected a number, got {str(cell)[:40]!r}",
                "repair the cell",
            )
        return InputError(
            message, remedy, file=self.path, where=self.where(row, column)
        )


def _list_size(cell: Any) -> tuple[int, float]:
    """Entries of a list, 0 for a number or what is neither, and the size of the largest."""
    try:
        values = np.asarray(json.loads(cell) if isinstance(cell, str) else cell, float)
    except (ValueError, TypeError):
        return 0, np.nan
    return values.size * values.ndim, float(np.abs(values).max(initial=0.0))


def _is_number(cell: Any) -> bool:
    try:
        float(cell)
    except (ValueError, TypeError):
        return False
    return True


def shortened(names: Sequence[str], limit: int = 40) -> str:
    """Names in a row, at most so many of them."""
    rest = len(names) - limit
    return ", ".join(names[:limit]) + (f" and {rest} more" if rest > 0 else "")


# What a reader of any format gives: the tables of a log, before anything is known of the arm that made it.


@dataclass(frozen=True)
class LogTable:
    """One table of a log.

    Attributes:
        name: topic, group or episode that holds it; empty if the file is one table.
        kind: type of the messages, or the format of the file.
        table: its columns. Those of ROS messages are named by field and joint, ``position[joint_1]`` or
            ``reference.positions[joint_1]``, beside ``t`` [s], the header's stamp.
    """

    name: str
    kind: str
    table: Table


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
    tables: tuple[LogTable, ...]
    robot_description: str | None = None
    notes: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()

    @property
    def names(self) -> list[str]:
        """Names of the tables, each once."""
        return list(dict.fromkeys(table.name for table in self.tables))
