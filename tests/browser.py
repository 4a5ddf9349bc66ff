"""A page in a real browser, which may ask for nothing elsewhere and complain of nothing."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from guard import HANG

playwright = pytest.importorskip(
    "playwright.sync_api", reason="Playwright is not installed: make setup"
)
NAMES = ("chromium", "chromium-browser", "google-chrome")
CHROMIUM = next(filter(None, map(shutil.which, NAMES)), None)
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium on this machine (Debian: chromium)"
)


@contextmanager
def opened(address: str, *own: str) -> Iterator[playwright.Page]:
    """The page of an address; ``own`` begins what it may ask for besides its own data."""
    with playwright.sync_playwright() as started:
        options = ["--enable-unsafe-swiftshader"]
        browser = started.chromium.launch(
            executable_path=CHROMIUM, args=options, timeout=1000 * HANG
        )
        context = browser.new_context(viewport={"width": 1280, "height": 900})
        context.set_default_timeout(1000 * HANG)
        context.grant_permissions(["clipboard-read", "clipboard-write"])
        page = context.new_page()
        asked, complaints = [], []
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda said: complaints.append(said.text) if said.type == "error" else None)  # fmt: skip
        page.goto(address)
        yield page
        browser.close()
    assert complaints == []
    assert [x for x in asked if not x.startswith((*own, "data:", "blob:"))] == []


def accessibility_problems(page: playwright.Page) -> list[str]:
    """What axe finds on a page."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    return [
        f"{violation['id']}: {node['html'][:120]}"
        for violation in axe.run(page).response["violations"]
        for node in violation["nodes"]
    ]
