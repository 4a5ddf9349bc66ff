"""The report in a real browser, without a network: drawn, usable by keyboard, readable in every scheme, accessible."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import documents
import numpy as np
import pytest
from browser import accessibility_problems, needs_chromium, opened, playwright

from gapscope.arm.dynamics.link_shapes import link_hulls
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.robots import load_nominal_arm
from gapscope.diagnosis.assessment.replay_gap import ReplayedMotion
from gapscope.reports.diagnosis import render

pytestmark = needs_chromium
COLOURED = """() => {
    const probe = document.body.appendChild(document.createElement("i"));
    probe.style.color = "var(--card)";
    const card = getComputedStyle(probe).color;
    probe.remove();
    const figure = document.querySelector("#torque-figure .main-svg");
    return getComputedStyle(figure).backgroundColor === card;
}"""
"""Whether the figures have the colours of the page."""
LARGEST = 3_000_000
"""Size of a report [bytes]."""


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of a diagnosis with two effects, the arm and its replayed motion."""
    diagnosis = documents.diagnosis(documents.two_effects())
    trace = diagnosis.traces[0]
    motion = ReplayedMotion(
        trace.recording, trace.t, trace.q, 1.1 * trace.q, 1.01 * trace.q
    )
    path = tmp_path_factory.mktemp("report") / "report.html"
    arm = load_nominal_arm("kuka_iiwa")
    render(replace(diagnosis, arm=arm, replayed=motion), path)
    return path


@pytest.fixture
def page(report: Path) -> Iterator[playwright.Page]:
    """The report, opened; it loads nothing but itself."""
    with opened(report.as_uri(), "file:") as page:
        yield page


def test_a_report_is_small(report):
    assert report.stat().st_size < LARGEST


def test_torque_and_arm_are_drawn(page):
    page.wait_for_function(
        "document.querySelectorAll('#torque-figure .scatterlayer .trace').length >= 3"
    )
    page.wait_for_function("document.querySelectorAll('#arm-view canvas').length === 1")
    page.wait_for_function("document.querySelectorAll('.js-plotly-plot').length >= 6")


def test_joints_are_chosen_by_mouse_and_by_keyboard(page):
    tabs = page.locator("#joint-tabs button")
    tabs.nth(1).click()
    assert tabs.nth(1).get_attribute("aria-pressed") == "true"
    page.keyboard.press("ArrowRight")
    assert tabs.nth(2).get_attribute("aria-pressed") == "true"
    assert tabs.nth(1).get_attribute("aria-pressed") == "false"


def test_the_moment_is_shared_by_arm_and_torque(page):
    page.locator("#recording").select_option("0")
    page.locator("#arm-time").fill("100")
    assert page.locator("#arm-now").text_content() != "0.00 s"
    page.wait_for_function(
        "document.querySelectorAll('#torque-figure .shapelayer path').length > 0"
    )


def test_the_arm_plays_and_pauses(page):
    play, now = page.locator("#arm-play"), page.locator("#arm-now")
    before = now.text_content()
    play.click()
    page.wait_for_function(f"document.getElementById('arm-now').value !== '{before}'")
    play.click()
    assert play.text_content() == "play"


def test_a_command_is_copied(page):
    button = page.locator("button[data-copy]").first
    button.click()
    copied = page.evaluate("navigator.clipboard.readText()")
    assert copied == button.get_attribute("data-copy") and "gapscope" in copied


def test_dark_turns_page_and_figures_dark(page):
    def lightness() -> float:
        colour = page.evaluate("getComputedStyle(document.body).backgroundColor")
        return float(np.mean([int(x) for x in colour[4:-1].split(",")]))

    def paper() -> str:
        return page.locator("#torque-figure .main-svg").first.evaluate(
            "e => getComputedStyle(e).backgroundColor"
        )

    light = lightness(), paper()
    page.emulate_media(color_scheme="dark")
    page.wait_for_function(COLOURED)
    assert lightness() < 60 < light[0]
    assert paper() != light[1]


def test_a_phone_needs_no_sideways_scrolling(page):
    page.set_viewport_size({"width": 390, "height": 800})
    # figures follow the width of the page a little later
    root = "document.documentElement"
    page.wait_for_function(f"{root}.scrollWidth <= {root}.clientWidth")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing(page, scheme):
    page.emulate_media(color_scheme=scheme)
    page.wait_for_function(COLOURED)
    assert accessibility_problems(page) == []


def test_it_prints_as_pages(page, tmp_path):
    pdf = page.pdf()
    assert pdf.startswith(b"%PDF") and len(pdf) > 20_000


def test_hulls_are_closed_and_seen_from_outside():
    for hull in link_hulls(RigidBody(load_nominal_arm("kuka_iiwa"))):
        a, b, c = (hull.vertices[hull.faces[:, k]] for k in range(3))
        centre = hull.vertices.mean(axis=0)
        volume = np.einsum("fi,fi->f", a - centre, np.cross(b - centre, c - centre))
        assert (volume > 0).all()
        edges = np.sort(np.vstack([hull.faces[:, [i, (i + 1) % 3]] for i in range(3)]))
        _, shared = np.unique(edges, axis=0, return_counts=True)
        assert (shared == 2).all()
