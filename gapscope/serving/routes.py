"""What is at an address: a page of the archive, a file of results, or nothing."""

from __future__ import annotations

from collections.abc import Sequence
from http import HTTPStatus
from typing import NamedTuple
from urllib.parse import parse_qs

from gapscope.archive.archive import Archive
from gapscope.archive.entry import UNREADABLE
from gapscope.reports.archive.addresses import FILES, UNITS
from gapscope.reports.archive.history_page import render_history
from gapscope.reports.archive.table_page import page_count, render_table
from gapscope.serving.result_file import TYPES, decoded, result_file

HTML, TEXT = "text/html; charset=utf-8", "text/plain; charset=utf-8"


class Answer(NamedTuple):
    """An answer: status, type and content, and whether it is a file of the archive."""

    status: HTTPStatus
    type: str
    content: bytes
    is_file: bool = False


def refusal(status: HTTPStatus, reason: str = "") -> Answer:
    """An answer without a page, in one line."""
    line = f"{status.value} {status.phrase}"
    text = f"{line}: {reason}\n" if reason else f"{line}\n"
    return Answer(status, TEXT, text.encode())


def answer(archive: Archive, target: str) -> Answer:
    """What is at the target of a request, as it stands in its first line."""
    path, _, query = target.partition("?")
    names = [] if path == "/" else decoded(path.split("/")[1:])
    if names is None or not path.startswith("/"):
        return refusal(HTTPStatus.NOT_FOUND)
    if not names:
        return _table(archive, query)
    place, *rest = names
    if place == UNITS and len(rest) == 1:
        return _unit(archive, rest[0])
    return _file(archive, rest) if place == FILES else refusal(HTTPStatus.NOT_FOUND)


def _table(archive: Archive, query: str) -> Answer:
    entries = archive.entries()
    asked = parse_qs(query).get("page", ["1"])[-1]
    # isdecimal alone takes digits of other scripts, and numbers of any length
    number = int(asked) if asked.isdecimal() and len(asked) < 7 else 0
    if not 1 <= number <= page_count(entries):
        return refusal(HTTPStatus.NOT_FOUND, "the table has no such page")
    return _page(render_table(entries, archive.root.name, number))


def _unit(archive: Archive, unit: str) -> Answer:
    of_unit = [
        entry
        for entry in archive.entries()
        if entry.unit == unit and entry.verdict != UNREADABLE
    ]
    if not of_unit:
        return refusal(HTTPStatus.NOT_FOUND, "no unit of this name")
    return _page(render_history(of_unit, unit))


def _file(archive: Archive, names: Sequence[str]) -> Answer:
    file = result_file(archive.root, names)
    if file is None:
        return refusal(HTTPStatus.NOT_FOUND)
    try:
        content = file.read_bytes()
    except OSError as error:
        return refusal(HTTPStatus.FORBIDDEN, error.strerror or "cannot be read")
    return Answer(HTTPStatus.OK, TYPES[names[-1]], content, is_file=True)


def _page(html: str) -> Answer:
    # a name on disk that is no valid text shows question marks
    return Answer(HTTPStatus.OK, HTML, html.encode("utf-8", "replace"))
