"""Files of tables: CSV in blocks, lines of JSON, Parquet, NPZ."""

from __future__ import annotations

import csv
import itertools
import json
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
from gapscope.arm.io.table import (
    Table,
    is_decimal,
    is_number,
    numbered,
    table_of_columns,
)

# Tables from CSV, JSON, Parquet and NPZ files.


_DELIMITERS = (",", ";", "\t")
FEWEST_COUNTED = 4
"""So many whole numbers in a row, from 0 or 1, are the header of a table without names [1]; fewer may be samples."""


ABOVE = 100
"""Lines at the beginning of a file among which its header is looked for. (budget)"""


def read_csv(path: Path) -> Table:
    """Table of a CSV file; the first line decides the delimiter: comma, semicolon or tab, else spaces.

    A header may begin with ``#`` or ``%``, and remarks may stand above it. Columns of a file without one are called by
    their numbers, from 1. Decimals have points or commas.

    Raises:
        InputError: the file is empty, has nothing below its header, a column twice, or is not text.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            top = list(itertools.islice(file, ABOVE))
            above = remarks(top)
            header, *below = top[above:] or [""]
            found = _numeric_table(path, header, "".join(below[:1]), above)
            if found is not None:
                return found
            text = itertools.chain(below, file)
            return table_of_lines(header, text, path, above + 2, above + 1)
    except UnicodeDecodeError:
        raise InputError(
            "is not a text in UTF-8",
            "if it is a text, in UTF-16 or Latin-1 as some programs write it, save it again as UTF-8",
            file=path,
        ) from None
    # a quote that nothing closes makes the beginning one cell
    except csv.Error as error:
        raise InputError(f"is not valid CSV ({error})", file=path) from None


def remarks(lines: Sequence[str]) -> int:
    """Number of lines above the header: they have another number of cells than samples and header."""
    for k, (line, after) in enumerate(itertools.pairwise(lines)):
        delimiter = _delimiter(line)
        row = _cells(line, delimiter)
        # the first row of samples: its header and what stands between have as many cells
        numbers = sum(map(is_decimal, row))
        if len(row) == len(_cells(after, delimiter)) > 1 and 2 * numbers > len(row):
            widths = [len(_cells(other, delimiter)) for other in lines[:k]]
            above = k
            while above and widths[above - 1] == len(row):
                above -= 1
            return above if above < k else 0
    return 0


def _cells(line: str, delimiter: str) -> list[str]:
    """What a line of a table holds; the header may be a remark to other programs."""
    line = line.lstrip("#% ")
    if delimiter == " ":
        return line.split()
    return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])


def _delimiter(line: str) -> str:
    """What parts the cells of a line: what is there most, since names may hold another; else blanks."""
    for one in _DELIMITERS[1:]:
        # commas are those of decimals
        if one in line and all(map(is_decimal, line.split(one))):
            return one
    most = max(_DELIMITERS, key=line.count)
    return most if most in line.strip() else " "


def _numeric_table(path: Path, header: str, first: str, above: int) -> Table | None:
    """The table of a file of numbers, parsed in blocks by Arrow: in a tenth of the time, and the memory, of its text.

    Columns whose first cell is a number hold numbers, each the float nearest to its decimal text, as that of Python.
    Whatever a file of numbers does not have, Arrow refuses, and the text reader says what is wrong with it.

    Args:
        path: the file, in UTF-8.
        header: the line with the names, or the first row of samples.
        first: the one below.
        above: number of the lines above.

    Returns:
        The table; ``None`` if text has to be read row by row.
    """
    import pyarrow as pa
    from pyarrow import csv as arrow

    delimiter = _delimiter(header.lstrip("#% "))
    if delimiter == " ":
        return None
    cells = _cells(first, delimiter)
    names, begin = _names(_cells(header, delimiter), path, above + 1)
    if len(cells) != len(names):
        return None
    # by the first cell: a later one that is none makes Arrow refuse the file
    number = dict(zip(names, map(is_decimal, cells), strict=True))
    commas = any(is_decimal(cell) and not is_number(cell) for cell in cells)
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
            arrow.ConvertOptions(
                column_types=types, null_values=[], decimal_point="," if commas else "."
            ),
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
    header: str,
    below: Iterable[str],
    path: Path,
    first_line: int,
    header_line: int = 1,
) -> Table:
    """Table of a CSV header and lines of the same file.

    Args:
        header: the line with the names, a row of samples if there are none.
        below: lines of samples.
        path: the file, for messages.
        first_line: number of the first of these lines in the file.
        header_line: number of the line with the names.

    Raises:
        InputError: see ``read_csv``.
    """
    header = header.lstrip("#% ")
    delimiter = _delimiter(header)
    text: Iterable[str] = itertools.chain([header], below)
    # blanks between columns: runs of them are one
    if delimiter == " ":
        text = (line.strip() for line in text)
    reader = csv.reader(text, delimiter=delimiter, strict=True, skipinitialspace=True)
    skipped = first_line - 2
    rows: list[Sequence[str | None]] = []
    lines, cut = [], {}
    try:
        first = next(reader, [])
        names, begin = _names(first, path, header_line)
        # a header without names is the first row of its file
        if begin == header_line and first_line == header_line + 1:
            rows.append(list(map(_with_point, first)))
            lines.append(header_line)
        for row in reader:
            # an empty line is no row; places still count it
            if not row:
                continue
            place = reader.line_num + skipped
            if len(row) != len(names):
                cut[place] = f"has {len(row)} cells, the header has {len(names)}"
            whole = place not in cut
            rows.append([*map(_with_point, row)] if whole else (None,) * len(names))
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


def _with_point(cell: str) -> str:
    """A cell with a decimal point if it is a number with a decimal comma."""
    return cell.replace(",", ".") if "," in cell and is_decimal(cell) else cell


def _names(first: list[str], path: Path, line: int) -> tuple[list[str], int]:
    """Names of the columns by the cells of a line, and the line at which the samples begin."""
    names = [name.strip() for name in first]
    if not any(names):
        raise InputError("is empty", "give a file with a header and samples", file=path)
    numbered = [str(j + 1) for j in range(len(names))]
    # 0 1 2 3 .. or 1 2 3 4 ..: written by a program that had no names
    counted = names in (numbered, [str(j) for j in range(len(names))])
    if counted and len(names) >= FEWEST_COUNTED:
        return numbered, line + 1
    # a number with a point is a sample: no header has one
    if any("." in name and is_number(name) for name in names) or all(
        map(is_decimal, names)
    ):
        return numbered, line
    twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if twice is not None:
        raise InputError(
            f"has the column {twice!r} twice",
            "rename one of them",
            file=path,
            where=f"line {line}",
        )
    return names, line + 1


def read_json_lines(path: Path) -> Table:
    """Table of a file with an object of JSON on each line; cells may be lists, and names of nested ones have dots.

    Raises:
        InputError: no line is an object of JSON.
    """
    import pandas as pd

    rows, cut = [], {}
    # what is no text is no JSON either
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        lines = {k: line for k, line in enumerate(file, start=1) if line.strip()}
    for number, line in lines.items():
        try:
            # a whole number may be beyond any of a computer's
            row = json.loads(line, parse_int=float)
        except (ValueError, RecursionError):
            row = None
        if not isinstance(row, dict):
            cut[number] = "is no object of JSON"
        rows.append({} if number in cut else row)
    if len(cut) == len(rows):
        raise InputError(
            "has no object of JSON on any line",
            "give a file with one sample a line",
            file=path,
        )
    frame = pd.json_normalize(rows)
    columns = {name: frame[name].to_numpy() for name in frame}
    return Table(path, columns, list(lines), "line", cut=cut)


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
    arrays = read_arrays(path, "is the file complete?")
    return table_of_columns(path, numbered(arrays))
