"""The archive: the diagnoses below a folder, and a small server that shows them in a browser."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Sequence
from datetime import datetime
from functools import lru_cache
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path, PurePath
from typing import Any, NamedTuple
from urllib.parse import parse_qs, unquote_to_bytes

from gapscope.arm.errors import InputError
from gapscope.arm.nearest_name import check_known
from gapscope.diagnosis.document.diagnosis_json import read_document
from gapscope.diagnosis.document.numbers import number_rows
from gapscope.diagnosis.document.wording import acts_on, parameter_texts
from gapscope.many.pages import (
    FILES,
    UNITS,
    page_count,
    render_history,
    render_table,
)
from gapscope.many.rows import CASE, UNITS_BY, Row, date_in_names, unit_name
from gapscope.reports.diagnosis import DOCUMENT, REPORT

# All diagnoses below a folder, read again only if their files have changed.


SECTIONS = ("effects", "possible")
SHOWN = ("verdict", "closed", "changes")
NOT_SHOWN = ("where", "alternatives", "gap_with_only_this", "gap_without_this")
"""Parts of a document and of its effects: what is kept for tables, and what is not."""
LARGEST = 50_000_000
"""Files that are larger are no diagnosis, which has some 100 kB [bytes]."""
_OTHER_VERSION = (LookupError, TypeError, ValueError, ArithmeticError)
"""What a document of the schema can still lead to; it must not hide the others."""
KEPT = 100_000
"""Rows of files that are not read again while they are unchanged [1]. (budget)"""


class Archive:
    """The diagnoses below a folder, at any depth.

    Hidden folders and links to folders are not entered. ``rows`` may be called from several threads.
    """

    def __init__(self, root: Path, units_by: str = CASE) -> None:
        """Take a folder; nothing is read yet.

        Raises:
            InputError: it is no folder, or ``units_by`` is neither ``case`` nor ``folder``.
        """
        check_known("name of units", units_by, UNITS_BY, where="--units-by")
        if not root.is_dir():
            remedy = "give the folder in which gapscope diagnose wrote its results"
            raise InputError("is not a folder", remedy, file=root)
        self.root, self.units_by = root.resolve(), units_by
        # by all that changes with its content: a file is read again only if it has changed
        self._row_of = lru_cache(KEPT)(self._read)

    def rows(self, progress: Callable[[str], None] | None = None) -> list[Row]:
        """All diagnoses as they are now, the latest first."""
        rows: list[Row] = []

        def closed(error: OSError) -> None:
            problem = f"folder: {error.strerror}"
            rows.append(self._unreadable(Path(error.filename), problem))

        for folder, folders, files in os.walk(self.root, onerror=closed):
            # in place: the walk enters what is left in this list
            folders[:] = [name for name in folders if not name.startswith(".")]
            if DOCUMENT not in files:
                continue
            file = Path(folder, DOCUMENT)
            try:
                found = file.stat()
                state = (found.st_mtime, found.st_size, REPORT in files)
                rows.append(self._row_of(file, *state))
            except OSError as error:  # removed just now, or a link that leads nowhere
                problem = f"cannot be read ({error.strerror})"
                rows.append(self._unreadable(file.parent, problem))
            if progress and len(rows) % 100 == 0:
                progress(f"{len(rows)} diagnoses")
        return sorted(rows, key=lambda row: (row.date, row.folder))[::-1]

    def _read(self, file: Path, changed: float, size: int, has_report: bool) -> Row:
        """The row of a file, last changed at a time [s since 1970]."""
        date = datetime.fromtimestamp(changed)
        # links resolved first: one may lead out of the folder
        if not file.resolve().is_relative_to(self.root):
            problem = "is a link that leaves the folder"
        elif not file.is_file():
            problem = "is not a file"
        elif size > LARGEST:
            problem = "is too large for a diagnosis"
        else:
            try:
                return self._row(file, date, has_report)
            except InputError as error:
                problem = error.problem
            except RecursionError:
                problem = "is nested too deeply"
            except _OTHER_VERSION as error:
                problem = f"is of another version of Gapscope ({error!r})"
        return self._unreadable(file.parent, problem, date)

    def _row(self, file: Path, changed: datetime, has_report: bool) -> Row:
        """The row of a diagnosis, with no more of its document than tables and histories show."""
        document = read_document(file)
        kept = {key: document[key] for key in SHOWN if key in document}
        for name in SECTIONS:
            kept[name] = [
                {key: one[key] for key in one if key not in NOT_SHOWN}
                for one in document[name]
            ]
        case, place = document["case"], self._place(file.parent)
        unit, date = unit_name(case, place, self.units_by), date_in_names(case, place)
        dated = date is not None
        row = Row(case, place, kept, "", unit, date or changed, dated, has_report)
        # what another version has written may not be shown
        every = (*row.effects, *row.possible)
        _ = row.changes, [(acts_on(one), parameter_texts(one)) for one in every]
        _ = list(number_rows(kept))
        return row

    def _unreadable(
        self, folder: Path, problem: str, changed: datetime | None = None
    ) -> Row:
        """The row of a file that is no diagnosis, or not yet."""
        place = self._place(folder)
        date = date_in_names("", place)
        name, when = PurePath(place).name, date or changed or datetime.now()
        return Row(name, place, None, problem, "", when, date is not None)

    def _place(self, folder: Path) -> str:
        return folder.relative_to(self.root).as_posix()


# From an address to a file of results, and to none other.


TYPES = {
    "report.html": "text/html; charset=utf-8",
    "diagnosis.json": "application/json",
    "corrected.yaml": "application/yaml",
}
"""The files that are served, by name, with their types."""
_FORBIDDEN = ("/", "\\", ":", "\0")
"""Not part of one name on some system."""


def plain_text(quoted: str) -> str:
    """A part of an address, decoded once, as a name on disk."""
    return os.fsdecode(unquote_to_bytes(quoted))


def file_names(path: str) -> list[str] | None:
    """Names of folders and file in the path of an address; ``None`` if one is no plain name, or hidden.

    It is split before it is decoded, so that an encoded slash or dot stays in its part.
    """
    names = [plain_text(part) for part in path.split("/")]
    for name in names:
        # a first dot is that of "." and ".." too
        if not name or name.startswith(".") or any(c in name for c in _FORBIDDEN):
            return None
    return names


def result_file(root: Path, names: Sequence[str]) -> Path | None:
    """The file of results at a place below a folder.

    Args:
        root: the folder, resolved.
        names: of the folders below it, and of the file at the end.

    Returns:
        The file, links resolved; ``None`` if its name is not that of a result, it is no file, or it lies outside.
    """
    if names[-1] not in TYPES:
        return None
    try:
        path = root.joinpath(*names).resolve(strict=True)
    except (OSError, RuntimeError, ValueError):  # missing, a loop, or too long a name
        return None
    return path if path.is_relative_to(root) and path.is_file() else None


# What is at an address: a page of the archive, a file of results, or nothing.


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
    # what stands behind the first part
    rest = path.removeprefix("/").partition("/")[2]
    if path == "/":
        rows = archive.rows()
        asked = parse_qs(query).get("page", ["1"])[-1]
        # isdecimal alone takes digits of other scripts, and numbers of any length
        number = int(asked) if asked.isdecimal() and len(asked) < 7 else 0
        if not 1 <= number <= page_count(rows):
            return refusal(HTTPStatus.NOT_FOUND, "the table has no such page")
        return _page(render_table(rows, archive.root.name, number))
    if path.startswith(f"/{UNITS}/"):
        unit, rows = plain_text(rest), archive.rows()
        own = [row for row in rows if row.unit == unit and row.document is not None]
        if not own:
            return refusal(HTTPStatus.NOT_FOUND, "no unit of this name")
        return _page(render_history(own, unit))
    names = file_names(rest) if path.startswith(f"/{FILES}/") else None
    file = result_file(archive.root, names) if names else None
    if names is None or file is None:
        return refusal(HTTPStatus.NOT_FOUND)
    # read whole: the head of the answer says its length
    try:
        content = file.read_bytes()
    except OSError as error:
        return refusal(HTTPStatus.FORBIDDEN, error.strerror or "cannot be read")
    return Answer(HTTPStatus.OK, TYPES[names[-1]], content, is_file=True)


def _page(html: str) -> Answer:
    # a name on disk that is no valid text shows question marks
    return Answer(HTTPStatus.OK, HTML, html.encode("utf-8", "replace"))


# The server: HTTP on the loopback interface, reading alone, for pages from this machine alone.


LOOPBACK = "127.0.0.1"
METHODS = "GET, HEAD"
_LOCAL = re.compile(r"(localhost|127\.0\.0\.1)(:\d{1,5})?", re.IGNORECASE)
"""Hosts by which this machine asks itself. Any port, since a tunnel changes it."""

_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data: blob:; "
    "form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
)
"""Pages hold all that they need: they load nothing and send nothing."""
_FILE_POLICY = f"{_POLICY}; sandbox allow-scripts allow-downloads allow-modals"
"""A report is a file that somebody else may have written: it has no access to the other pages."""
_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class ArchiveServer(ThreadingHTTPServer):
    """Serves an archive until ``shutdown``; one thread for each request."""

    daemon_threads = True

    def __init__(self, archive: Archive, port: int = 0) -> None:
        """Take a port of the loopback interface.

        Args:
            archive: that is served.
            port: 0 for any that is free.

        Raises:
            InputError: the port is taken, or not allowed.
        """
        self.archive = archive
        try:
            super().__init__((LOOPBACK, port), _Handler)
        except (OSError, OverflowError) as error:
            remedy = "give another --port, or 0 for any that is free"
            raise InputError(f"port {port}: {error}", remedy) from None

    @property
    def address(self) -> str:
        """Where a browser finds it."""
        return f"http://{LOOPBACK}:{self.server_port}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Show a fault of the program; a browser that goes away is none."""
        if not isinstance(sys.exc_info()[1], (ConnectionError, TimeoutError)):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    """Answers GET and HEAD, and refuses all else."""

    server: ArchiveServer
    server_version, sys_version = "gapscope", ""
    timeout = 30  # s; a connection that says nothing holds a thread
    error_content_type = "text/plain; charset=utf-8"
    error_message_format = "%(code)d %(message)s\n"

    def do_GET(self) -> None:
        self._send(self._answer())

    def do_HEAD(self) -> None:
        self._send(self._answer(), body=False)

    def _refuse_method(self) -> None:
        self._send(refusal(HTTPStatus.METHOD_NOT_ALLOWED, f"{METHODS} alone"))

    do_POST = do_PUT = do_PATCH = do_DELETE = _refuse_method  # noqa: N815
    do_OPTIONS = do_TRACE = do_CONNECT = _refuse_method  # noqa: N815

    def _answer(self) -> Answer:
        # a foreign page whose name was made to point here shows by its host
        hosts = self.headers.get_all("Host", [])
        if len(hosts) != 1 or not _LOCAL.fullmatch(hosts[0].strip()):
            reason = f"ask for {self.server.address}"
            return refusal(HTTPStatus.MISDIRECTED_REQUEST, reason)
        return answer(self.server.archive, self.path)

    def _send(self, found: Answer, *, body: bool = True) -> None:
        self.send_response(found.status)
        self.send_header("Content-Type", found.type)
        # of HEAD as well, though no body follows
        self.send_header("Content-Length", str(len(found.content)))
        policy = _FILE_POLICY if found.is_file else _POLICY
        self.send_header("Content-Security-Policy", policy)
        if found.status == HTTPStatus.METHOD_NOT_ALLOWED:
            self.send_header("Allow", METHODS)
        self.end_headers()
        if body:
            self.wfile.write(found.content)

    def end_headers(self) -> None:
        """Add what every answer carries, errors of the library included."""
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        super().end_headers()

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing of single requests."""
