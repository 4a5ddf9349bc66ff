"""The pages of an archive in a real browser: filtered, followed to a unit and a report, accessible."""

from __future__ import annotations

import json
import threading

import documents
import pytest
from browser import accessibility_problems, needs_chromium, opened

from gapscope.many.archive import Archive, ArchiveServer
from gapscope.reports.diagnosis import render

PLOT = ".js-plotly-plot .main-svg"  # drawn some time after the page is there
pytestmark = needs_chromium


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """An archive of one arm over two months, and a healthy one."""
    root = tmp_path_factory.mktemp("archive")
    for folder, document in (
        ("2026-01/arm", documents.two_effects()),
        ("2026-02/arm", documents.two_effects()),
        ("2026-02/well", documents.no_gap()),
    ):
        document["case"] = folder.split("/")[1]
        (root / folder).mkdir(parents=True)
        (root / folder / "diagnosis.json").write_text(json.dumps(document))
        render(documents.diagnosis(document), root / folder / "report.html")
    with ArchiveServer(Archive(root)) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server.address
        server.shutdown()
        thread.join()


@pytest.fixture
def page(address):
    """The table, opened; no page asks for anything elsewhere."""
    with opened(address, address) as page:
        yield page


def test_from_the_table_to_a_unit_and_to_a_report(page):
    page.fill("#filter", "ARM payload")
    assert page.locator(".archive tbody tr:visible").count() == 2
    assert "2 of the 3 rows" in page.inner_text("#shown")

    page.click("a[href='/unit/arm'] >> nth=0")
    page.wait_for_selector(PLOT)
    points = "document.querySelector('.js-plotly-plot').data[0].x.length"
    assert page.evaluate(points) == 2

    page.click("text=report >> nth=0")
    assert "Torque over time" in page.inner_text("main")
    page.wait_for_selector(PLOT)
    assert page.evaluate("window.origin") == "null"  # shut in


def test_no_accessibility_problem_is_found(page):
    for address in (page.url, f"{page.url}unit/arm"):
        page.goto(address)
        assert accessibility_problems(page) == []
