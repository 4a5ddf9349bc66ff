"""What is at an address: a page of the archive, a file of results, or nothing."""

from __future__ import annotations

from http import HTTPStatus
from typing import NamedTuple
from urllib.parse import parse_qs

from gapscope.archive.archive import Archive
from gapscope.archive.entry import UNREADABLE
from gapscope.reports.archive.addresses import FILES, UNITS
from gapscope.reports.archive.history_page import render_history
from gapscope.reports.archive.table_page import page_count, render_table
from gapscope.serving.result_file import TYPES, file_names, plain_text, result_file

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
    if path == "/":
        return _table(archive, query)
    if path.startswith(f"/{UNITS}/"):
        return _unit(archive, path.removeprefix(f"/{UNITS}/"))
    if path.startswith(f"/{FILES}/"):
        return _file(archive, path.removeprefix(f"/{FILES}/"))
    return refusal(HTTPStatus.NOT_FOUND)


def _table(archive: Archive, query: str) -> Answer:
    entries = archive.entries()
    asked = parse_qs(query).get("page", ["1"])[-1]
    # isdecimal alone takes digits of other scripts, and numbers of any length
    number = int(asked) if asked.isdecimal() and len(asked) < 7 else 0
    if not 1 <= number <= page_count(entries):
        return refusal(HTTPStatus.NOT_FOUND, "the table has no such page")
    return _page(render_table(entries, archive.root.name, number))


def _unit(archive: Archive, quoted: str) -> Answer:
    unit = plain_text(quoted)
    of_unit = [
        entry
        for entry in archive.entries()
        if entry.unit == unit and entry.verdict != UNREADABLE
    ]
    if not of_unit:
        return refusal(HTTPStatus.NOT_FOUND, "no unit of this name")
    return _page(render_history(of_unit, unit))


def _file(archive: Archive, path: str) -> Answer:
    names = file_names(path)
    file = result_file(archive.root, names) if names else None
    if names is None or file is None:
        return refusal(HTTPStatus.NOT_FOUND)
    try:
        content = file.read_bytes()
    except OSError as error:
        return refusal(HTTPStatus.FORBIDDEN, error.strerror or "cannot be read")
    return Answer(HTTPStatus.OK, TYPES[names[-1]], content, is_file=True)


def _page(html: str) -> Answer:
    # a name on disk that is no valid text shows question marks
    return Answer(HTTPStatus.OK, HTML, html.encode("utf-8", "replace"))
