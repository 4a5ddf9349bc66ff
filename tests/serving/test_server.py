"""The server, asked as a browser or an intruder would: pages, files of results, and refusals."""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path
from typing import NamedTuple

import documents
import pytest
from guard import HANG

from gapscope.arm.errors import InputError
from gapscope.many.archive import Archive, ArchiveServer

SECRET = "not for the browser"
EVIL = "<script>alert('x')</script>"


class Got(NamedTuple):
    """Status, headers and text of an answer."""

    status: int
    headers: dict[str, str]
    text: str


def put(root: Path, folder: str, **changes: object) -> None:
    """Write results with some keys of the diagnosis changed."""
    place = root / folder
    place.mkdir(parents=True)
    content = {**documents.two_effects(), **changes}
    (place / "diagnosis.json").write_text(json.dumps(content))
    (place / "report.html").write_text(f"report of {folder}")
    (place / "corrected.yaml").write_text("schema: 1\n")


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An archive of three months, one of them half written, beside files that are nobody's business."""
    above = tmp_path_factory.mktemp("above")
    for name in ("secret.txt", "report.html", "diagnosis.json"):
        (above / name).write_text(SECRET)
    root = above / "archive"
    put(root, "2026-01/cell", case="cell")
    put(root, "2026-02/cell", case="cell")
    put(root, "2026-03/odd & café", case=EVIL)
    put(root, "2026-03/slashes", case="hall/é:7")
    (root / "2026-04" / "cell").mkdir(parents=True)
    (root / "2026-04" / "cell" / "diagnosis.json").write_text('{"schema": 1, "ca')

    for name in ("secret.txt", ".hidden", "case.yaml"):
        (root / name).write_text(SECRET)
    (root / ".git").mkdir()
    (root / ".git" / "report.html").write_text(SECRET)
    links = root / "links"
    links.mkdir()
    (links / "report.html").symlink_to(above / "secret.txt")
    (links / "out").symlink_to(above)
    (links / "diagnosis.json").mkdir()
    (links / "corrected.yaml").symlink_to(links / "corrected.yaml")
    return root


@pytest.fixture(scope="module")
def server(root: Path) -> Iterator[ArchiveServer]:
    with ArchiveServer(Archive(root)) as started:
        thread = threading.Thread(target=started.serve_forever)
        thread.start()
        yield started
        started.shutdown()
        thread.join()


@pytest.fixture
def ask(server: ArchiveServer):
    """Sends a request as it is given, nothing in its address made harmless."""

    def call(target: str, method: str = "GET", host: str | None = None) -> Got:
        connection = HTTPConnection("127.0.0.1", server.server_port, timeout=HANG)
        connection.putrequest(method, target, skip_host=host is not None)
        if host:
            connection.putheader("Host", host)
        connection.endheaders()
        found = connection.getresponse()
        got = Got(found.status, dict(found.getheaders()), found.read().decode())
        connection.close()
        return got

    return call


PAGES = {
    "/": (
        *("2026-01-01", "2026-02-01", "Actuator delay", "joints 4 and 5"),
        *('href="/unit/cell"', 'href="/files/2026-01/cell/report.html"'),
        'href="/files/2026-03/odd%20%26%20caf%C3%A9/report.html"',
        'href="/unit/hall%2F%C3%A9%3A7"',
        *("1 unreadable", "is not valid JSON", "&lt;script&gt;alert"),
    ),
    "/unit/cell": (
        *("<h2>Actuator delay, joint 4</h2>", "<h2>Actuator delay, joint 5</h2>"),
        *("<h2>Payload, the whole arm</h2>", "error_y"),
        "Named in 2 of 2 diagnoses",
    ),
    "/unit/hall%2F%C3%A9%3A7": ("hall/é:7: effects over time",),
    "/files/2026-03/odd%20%26%20caf%C3%A9/report.html": ("report of 2026-03/odd & café",),
}  # fmt: skip


@pytest.mark.parametrize("target", PAGES)
def test_pages_show_diagnoses_with_values_and_links_and_escape_names(ask, target):
    html = ask(target).text
    assert [words for words in PAGES[target] if words not in html] == []
    assert EVIL not in html
    if target == "/unit/cell":
        assert html.count("Plotly.newPlot(") == 3


@pytest.mark.parametrize(
    ("name", "kind", "begin"),
    [
        ("report.html", "text/html; charset=utf-8", "report of 2026-01/cell"),
        ("diagnosis.json", "application/json", '{"schema": 1'),
        ("corrected.yaml", "application/yaml", "schema: 1"),
    ],
)
def test_files_of_results_have_their_types(ask, name, kind, begin):
    got = ask(f"/files/2026-01/cell/{name}")
    assert got.status == 200 and got.text.startswith(begin)
    assert got.headers["Content-Type"] == kind
    assert "sandbox" in got.headers["Content-Security-Policy"]


NOT_SERVED = (
    *("/files/../report.html", "/files/2026-01/../../report.html"),
    *("/files/%2e%2e/report.html", "/files/%2E%2E%2freport.html"),
    *("/files/..%2freport.html", "/files/%252e%252e/report.html"),
    *("/files/..%5creport.html", "/files/..\\report.html"),
    *("/files/.%2e/secret.txt", "/files/....//report.html"),
    *("/files//{above}/report.html", "/files/{above}/report.html"),
    *("/files/%2f{above}/report.html", "//{above}/report.html"),
    *("/files/C:/report.html", "/files/report.html%00"),
    *("/files/2026-01/cell/report.html/", "/files/2026-01/cell/./report.html"),
    *("/files/2026-01/cell/", "/files/2026-01/cell", "/files/", "/files"),
    *("/files/secret.txt", "/files/case.yaml", "/files/.hidden"),
    *("/files/.git/report.html", "/files/links/report.html"),
    *("/files/links/out/report.html", "/files/links/diagnosis.json"),
    *("/files/links/corrected.yaml", "/files/" + "x" * 3000 + "/report.html"),
    *("/../secret.txt", "/secret.txt", "/unit/nobody", "/unit/../files/secret.txt"),
    *("/?page=0", "/?page=2", "/?page=-1", "/?page=9" + "9" * 5000),
    *("file:///etc/passwd", "http://127.0.0.1/", "*"),
)


@pytest.mark.parametrize("target", NOT_SERVED)
def test_nothing_else_is_served(ask, root, target):
    got = ask(target.format(above=root.parent))
    assert got.status == 404
    assert SECRET not in got.text and got.headers["X-Content-Type-Options"] == "nosniff"


@pytest.mark.parametrize("method", ["POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE"])  # fmt: skip
def test_only_reading_is_allowed(ask, method):
    got = ask("/", method)
    assert got.status == 405 and got.headers["Allow"] == "GET, HEAD"
    assert ask("/", "MAKE").status == 501


def test_head_has_the_headers_of_get_and_no_content(ask):
    head, get = ask("/", "HEAD"), ask("/")
    assert (head.status, head.text) == (200, "")
    assert head.headers["Content-Length"] == get.headers["Content-Length"]


def test_names_of_this_machine_alone_are_accepted(ask):
    for host in ("localhost", "LOCALHOST:9000", "127.0.0.1:80"):
        assert ask("/", host=host).status == 200
    foreign = ("evil.example", "localhost.evil.example", "127.0.0.1.nip.io")
    for host in (*foreign, "0.0.0.0", "localhost:1:2", ""):
        got = ask("/", host=host)
        assert got.status == 421 and "cell" not in got.text


def test_pages_may_load_and_send_nothing(ask):
    for target in ("/", "/unit/cell"):
        policy = ask(target).headers["Content-Security-Policy"]
        assert "default-src 'none'" in policy and "form-action 'none'" in policy
        assert "frame-ancestors 'none'" in policy


def test_new_results_appear_on_reload(ask, root):
    assert "2025-12-01" not in ask("/").text
    put(root, "2025-12/later", case="later")
    assert "2025-12-01" in ask("/").text
    shutil.rmtree(root / "2025-12")
    assert "2025-12-01" not in ask("/").text


def test_it_listens_on_the_loopback_interface_alone(server):
    assert server.server_address[0] == "127.0.0.1"
    with pytest.raises(InputError, match="another --port"):
        ArchiveServer(server.archive, server.server_port)
