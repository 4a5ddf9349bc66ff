"""Files of tables: CSV in blocks, Parquet, NPZ."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.input_file import (
    check_unpacked,
    complete_file,
    read_arrays,
)
from gapscope.arm.io.table import Table, is_number, numbered

# Tables from CSV, Parquet and NPZ files.


_DELIMITERS = (",", ";", "\t")


def read_csv(path: Path) -> Table:
    """Table of a CSV file; the first line decides the delimiter: comma, semicolon or tab, else spaces.

    A header may begin with ``#`` or ``%``. Columns of a file without one are called by their numbers, from 1.

    Raises:
        InputError: the file is empty, has nothing below its header, a column twice, or is not text.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            header, first = file.readline(), file.readline()
            found = _numeric_table(path, header, first)
            if found is not None:
                return found
            return table_of_lines(header, itertools.chain([first], file), path)
    except UnicodeDecodeError:
        raise InputError(
            "is not a text in UTF-8",
            "if it is a text, in UTF-16 or Latin-1 as some programs write it, save it again as UTF-8",
            file=path,
        ) from None


def _numeric_table(path: Path, header: str, first: str) -> Table | None:
    """The table of a file of numbers, parsed in blocks by Arrow: in a tenth of the time, and the memory, of its text.

    Columns whose first cell is a number hold numbers, each the float nearest to its decimal text, as that of Python.
    Whatever a file of numbers does not have, Arrow refuses, and the text reader says what is wrong with it.

    Args:
        path: the file, in UTF-8.
        header: its first line.
        first: the one below.

    Returns:
        The table; ``None`` if text has to be read row by row.
    """
    import pyarrow as pa
    from pyarrow import csv as arrow

    header = header.lstrip("#% ")
    # the one that is there most: names may hold another
    delimiter = max(_DELIMITERS, key=header.count)
    if delimiter not in header.strip():
        return None
    split = [
        next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
        for line in (header, first)
    ]
    names, begin = _names(split[0], path)
    if len(split[1]) != len(names):
        return None
    # by the first cell: a later one that is none makes Arrow refuse the file
    number = dict(zip(names, map(is_number, split[1]), strict=True))
    types = {name: pa.float64() if number[name] else pa.string() for name in names}
    try:
        read = arrow.read_csv(
            path,
            arrow.ReadOptions(
                use_threads=False, column_names=names, skip_rows=begin - 1
            ),
            # an empty line is an error too: rows are numbered as lines are
            arrow.ParseOptions(delimiter=delimiter, ignore_empty_lines=False),
            # an empty cell is an error that has a place, not a missing value
            arrow.ConvertOptions(column_types=types, null_values=[]),
        )
    except (pa.ArrowException, OSError, ValueError):
        return None
    columns: dict[str, Any] = {}
    for name in names:
        columns[name] = read.column(0).to_numpy()
        # column by column: never two copies of the file
        read = read.remove_column(0)
        if not number[name]:
            columns[name] = tuple(text.lstrip() for text in columns[name])
        # what is not finite is shown as it is written
        elif not np.isfinite(columns[name]).all():
            return None
    return Table(path, columns, range(begin, len(columns[names[0]]) + begin), "line")


def table_of_lines(
    header: str, below: Iterable[str], path: Path, first_line: int = 2
) -> Table:
    """Table of a CSV header and lines of the same file.

    Args:
        header: the first line of the file, a row of samples if it has no names.
        below: lines of samples.
        path: the file, for messages.
        first_line: number of the first of these lines in the file.

    Raises:
        InputError: see ``read_csv``.
    """
    header = header.lstrip("#% ")
    delimiter = max(_DELIMITERS, key=header.count)
    text: Iterable[str] = itertools.chain([header], below)
    # blanks between columns: runs of them are one
    if delimiter not in header.strip() and " " in header.strip():
        delimiter, text = " ", (line.strip() for line in text)
    reader = csv.reader(text, delimiter=delimiter, strict=True, skipinitialspace=True)
    skipped = first_line - 2
    rows: list[Sequence[str | None]] = []
    lines, cut = [], {}
    try:
        first = next(reader, [])
        names, begin = _names(first, path)
        # a header without names is the first row of its file
        if begin == 1 and not skipped:
            rows.append(first)
            lines.append(1)
        for row in reader:
            # an empty line is no row; places still count it
            if not row:
                continue
            place = reader.line_num + skipped
            if len(row) != len(names):
                cut[place] = f"has {len(row)} cells, the header has {len(names)}"
            rows.append(row if place not in cut else (None,) * len(names))
            lines.append(place)
    except csv.Error as error:
        raise InputError(
            f"is not valid CSV ({error})",
            file=path,
            where=f"line {reader.line_num + skipped}",
        ) from None
    if not rows:
        raise InputError(
            "has a header and no rows", "give a file with samples", file=path
        )
    columns = dict(zip(names, zip(*rows, strict=True), strict=True))
    return Table(path, columns, lines, "line", cut=cut)


def _names(first: list[str], path: Path) -> tuple[list[str], int]:
    """Names of the columns by the cells of the first line, and the line at which the samples begin."""
    names = [name.strip() for name in first]
    if not any(names):
        raise InputError("is empty", "give a file with a header and samples", file=path)
    numbered = [str(j + 1) for j in range(len(names))]
    # 0 1 2 3 .. or 1 2 3 4 ..: written by a program that had no names
    if names in (numbered, [str(j) for j in range(len(names))]):
        return numbered, 2
    # a number with a point is a sample: no header has one
    if any("." in name and is_number(name) for name in names) or all(
        map(is_number, names)
    ):
        return numbered, 1
    twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if twice is not None:
        raise InputError(
            f"has the column {twice!r} twice",
            "rename one of them",
            file=path,
            where="line 1",
        )
    return names, 2


def read_parquet(path: Path) -> Table:
    """Table of a Parquet file.

    Raises:
        InputError: the file is damaged, or has no rows.
    """
    import pyarrow.parquet as pq

    with complete_file(path, "Parquet"), pq.ParquetFile(path) as file:
        check_unpacked(parquet_size(file.metadata), path)
        # one column at a time: never two copies of the file
        columns = {
            name: file.read([name]).column(name).to_numpy()
            for name in file.schema_arrow.names
        }
        count = len(next(iter(columns.values()), ()))
        # each column is read alone, so that a damaged page may leave one shorter
        for name, column in columns.items():
            if len(column) != count:
                raise ValueError(
                    f"column {name!r} has {len(column)} rows, the first {count}"
                )
    if not count:
        raise InputError("has no rows", "give a file with samples", file=path)
    return Table(path, columns, range(1, count + 1))


def parquet_size(metadata: Any) -> float:
    """Size of a Parquet file once unpacked, by what it states [bytes]."""
    groups = [metadata.row_group(k) for k in range(metadata.num_row_groups)]
    stated = sum(group.total_byte_size for group in groups)
    # a damaged footer may state less than the pages hold
    return max(stated, 8 * metadata.num_rows * metadata.num_columns)


def read_npz(path: Path) -> Table:
    """Table of an NPZ file; an array ``q`` of shape (N, n) becomes the columns ``q1..qn``.

    Raises:
        InputError: the file is damaged, has no rows, or arrays of different length.
    """
    columns = numbered(read_arrays(path, "is the file complete?"))
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
    return Table(path, columns, range(1, max(lengths) + 1))
