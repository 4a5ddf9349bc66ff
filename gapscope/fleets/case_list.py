"""Lists of cases: a text file with an address a line, or a table that also names unit and date."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from datetime import date
from pathlib import Path
from typing import Any

import fsspec

from gapscope.arm.errors import InputError
from gapscope.fleets.addresses import CASE_FILE, CaseAddress, find_cases

ENDINGS = (".txt", ".csv")
COLUMNS = ("case", "unit", "date")


def all_cases(addresses: tuple[str, ...]) -> Iterator[CaseAddress]:
    """The cases at several addresses, each of which may be a list."""
    for address in addresses:
        found = read_list if address.endswith(ENDINGS) else find_cases
        yield from found(address)


def read_list(address: str) -> Iterator[CaseAddress]:
    """The cases of a list, each of which is the folder of one case.

    A ``.txt`` file has an address a line; what begins with ``#`` is left out. A ``.csv`` file has the columns ``case``
    and, if wanted, ``unit`` and ``date`` (``YYYY-MM-DD``). Relative paths start from the folder of the list.

    Raises:
        InputError: the list cannot be read; names the line.
    """
    try:
        with fsspec.open(address, "rt", encoding="utf-8", newline="") as file:
            rows = _table(file, address) if address.endswith(".csv") else _lines(file)
            for number, row in rows:
                yield _case(row, number, address)
    except (OSError, ValueError, ImportError) as error:
        raise InputError(
            f"{address}: cannot be read ({error})", "give a list of cases"
        ) from None


def _lines(file: Any) -> Iterator[tuple[int, dict[str, str]]]:
    for number, line in enumerate(file, start=1):
        text = line.strip()
        if text and not text.startswith("#"):
            yield number, {"case": text}


def _table(file: Any, address: str) -> Iterator[tuple[int, dict[str, str]]]:
    reader = csv.DictReader(file)
    header = tuple(reader.fieldnames or ())
    if "case" not in header or not set(header) <= set(COLUMNS):
        raise InputError(
            f"has the columns {', '.join(header) or 'none'}",
            f"expected are case, and if wanted unit and date, out of {', '.join(COLUMNS)}",
            file=address,
            where="line 1",
        )
    for row in reader:
        texts = {key: (value or "").strip() for key, value in row.items()}
        yield reader.line_num, texts


def _case(row: dict[str, str], number: int, address: str) -> CaseAddress:
    where = f"line {number}"
    day = row.get("date", "")
    try:
        day and date.fromisoformat(day)
    except ValueError:
        raise InputError(
            f"{day!r} is no date", "write YYYY-MM-DD", file=address, where=where
        ) from None
    if not row["case"]:
        raise InputError("names no case", "give its address", file=address, where=where)
    place = _absolute(row["case"], address).removesuffix(f"/{CASE_FILE}")
    return CaseAddress(place.rstrip("/"), row.get("unit", ""), day)


def _absolute(text: str, address: str) -> str:
    """An address as it is, or a path that starts from the folder of the list."""
    if "://" in text or text.startswith("/"):
        return text
    if "://" in address:
        return f"{address.rpartition('/')[0]}/{text}"
    return str((Path(address).resolve().parent / text).as_posix())
