"""The server: HTTP on the loopback interface, reading alone, for pages from this machine alone."""

from __future__ import annotations

import re
import sys
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from gapscope.archive.archive import Archive
from gapscope.arm.errors import InputError
from gapscope.serving.routes import Answer, answer, refusal

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
