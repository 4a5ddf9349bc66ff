"""The report: one file that says what was found, loads nothing, escapes names, and draws offline."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import documents
import numpy as np
import pytest

from gapscope.diagnosis.document.wording import verdict_sentence
from gapscope.diagnosis.locate import MotionRows, locate
from gapscope.diagnosis.result import Located, Spectrum
from gapscope.many.pages import render_summary
from gapscope.many.rows import Row
from gapscope.reports.diagnosis import (
    POINTS_PER_CURVE,
    keep_extremes,
    payload,
    render,
)
from gapscope.reports.diagnosis import place_curves as curves

EVIL = "<script>alert('x')</script><img src=http://evil.example/x.png>"


class Page(HTMLParser):
    """Addresses and scripts of a page, and its text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.tags: list[str] = []
        self.words: list[str] = []
        self.feed(html)
        self.text = re.sub(r"\s+", " ", " ".join(self.words))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [
            value or ""
            for name, value in attrs
            if name in ("src", "href", "srcset", "action")
        ]

    def handle_data(self, data: str) -> None:
        if self.tags and self.tags[-1] not in ("script", "style"):
            self.words.append(data)


def located(stage: str) -> Located:
    """A joint whose gap is large at one place, in one interval, and hums."""
    t = np.arange(5000) / 250.0
    q = np.column_stack([np.sin(0.9 * t + j) + 0.3 * np.sin(2.3 * t) for j in range(7)])
    dq = np.gradient(q, 1 / 250, axis=0)
    rows = MotionRows(
        t,
        q,
        dq,
        np.gradient(dq, 1 / 250, axis=0),
        np.zeros(5000, dtype=int),
        (250.0,),
        ("recording_a.csv",),
    )
    white = np.random.default_rng(0).standard_normal((5000, 7))
    error = (
        0.05 * white
        + (np.abs(q) < 0.2) * white
        + 0.8 * np.sin(2 * np.pi * 6 * t)[:, None] * (t > 12)[:, None]
    )
    return Located(stage, locate(error[:, 3], rows, 9 * np.cos(q), 0.05, 4))


def rendered(document: dict[str, Any], folder: Path) -> Page:
    render(documents.diagnosis(document), folder / "report.html")
    return Page((folder / "report.html").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    "make",
    [documents.two_effects, documents.no_gap, documents.unexplained, documents.changed],
)
def test_one_file_that_loads_nothing(
    make: Callable[[], dict[str, Any]], tmp_path: Path
) -> None:
    page = rendered(make(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]
    assert all(address.startswith("#") for address in page.addresses)
    assert "link" not in page.tags and "iframe" not in page.tags
    assert verdict_sentence(make()) in page.text


def test_effects_are_given_on_only_where_no_cause_is_missing(tmp_path: Path) -> None:
    offer, look = "Give the effects found", "Look at what stays unexplained"
    known = documents.two_effects()
    text = rendered(known, tmp_path).text
    assert offer in text and look not in text
    text = rendered(
        documents.unexplained() | {"effects": known["effects"]}, tmp_path
    ).text
    assert look in text and offer not in text


def test_commands_name_the_files_of_the_case(tmp_path: Path) -> None:
    known = replace(
        documents.diagnosis(documents.two_effects()), case_file=Path("my arm/case.yaml")
    )
    render(known, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert f"{tmp_path}/corrected.yaml --case &#39;my arm/case.yaml&#39;" in page


def test_anchors_lead_somewhere(tmp_path: Path) -> None:
    page = rendered(documents.two_effects(), tmp_path)
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.addresses and all(
        f'id="{address[1:]}"' in html for address in page.addresses
    )


FINDINGS = (
    *("8.80 ± 0.20", "14.60 ± 0.30", "+1.051 ± 0.013", "−1.2 ± 1.0", "98 %", "78 %"),
    *("96 %", "0.655", "0.066", "acceleration reversals above 2 Hz"),
    *("a chirp above 10 Hz", "a lag bends it", "−14.2", "500 Hz", "1.9°"),
    *("3 samples repeat their time stamp", "A chirp on joints 4 and 5"),
    *("Torque NRMSE", "panda_joint7"),
)
COMPARED = (
    *("Compared with friday", "2 recordings: a.csv, b.csv", "determine 43 values"),
    *("2.000 ± 0.020", "0.013", "2.20 (+10 %)", "3.00 (same)", "0.017", "up to 15 %"),
    *("torque offset (joints 1–3)", "94 %", "lack up to 1 %"),
    "on top of what it was then",
)


@pytest.mark.parametrize(
    ("make", "findings"),
    [(documents.two_effects, FINDINGS), (documents.changed, COMPARED)],
)
def test_the_findings_are_in_the_report(
    make: Callable[[], dict[str, Any]], findings: tuple[str, ...], tmp_path: Path
) -> None:
    page = rendered(make(), tmp_path)
    assert not [said for said in findings if said not in page.text]
    compared = make is documents.changed
    assert ("#against" in page.addresses) == compared


def test_without_optional_keys_and_without_curves(tmp_path: Path) -> None:
    document = documents.two_effects()
    full = documents.diagnosis(document)
    optional = "arm recordings conditioning warnings where considered judged_on"
    for key in optional.split():
        del document[key]
    document["next_recording"] = None
    for stage in ("before", "after"):
        document["gap"][stage]["replay_rmse"] = None
    empty = Spectrum(np.zeros(0), np.zeros((0, 7)), np.zeros((0, 7)))
    render(type(full)(document, full.effects, (), (), empty), tmp_path / "report.html")
    text = Page((tmp_path / "report.html").read_text(encoding="utf-8")).text
    assert "Torque over time" not in text and "Replay RMSE before" not in text
    assert "None needed" in text


def test_effects_outside_the_catalogue_are_shown(tmp_path: Path) -> None:
    document = documents.two_effects()
    document["effects"][0]["effect"] = "joint_swap"
    assert "Joint swap" in rendered(document, tmp_path).text


def test_names_are_escaped(tmp_path: Path) -> None:
    document = documents.two_effects() | {
        "case": EVIL,
        "warnings": [EVIL],
        "next_recording": EVIL,
        "judged_on": EVIL,
    }
    document["arm"] = {
        "robot": EVIL,
        "joints": [EVIL + str(number) for number in range(7)],
    }
    document["recordings"][0]["name"] = document["where"][0]["regime"] = document[
        "considered"
    ][0]["reason"] = EVIL
    page = rendered(document, tmp_path)
    assert EVIL not in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "img" not in page.tags and page.tags.count("script") == 3
    render_summary(
        [Row(EVIL, EVIL, document), Row(EVIL, "b", None, EVIL)],
        tmp_path / "summary.html",
    )
    summary = Page((tmp_path / "summary.html").read_text(encoding="utf-8"))
    assert "script" not in summary.tags and "img" not in summary.tags


def test_curves_are_thinned_but_keep_their_peaks() -> None:
    series = np.sin(np.linspace(0.0, 9.0, 60_000))
    series[41_234] = 7.0
    keep = keep_extremes([series, -series], 1000)
    assert len(keep) <= 1000 and series[keep].max() == 7.0 and np.all(np.diff(keep) > 0)
    assert np.array_equal(keep_extremes([series[:9]], 1000), np.arange(9))
    curves = payload(documents.diagnosis(documents.two_effects()))["recordings"][0][
        "joints"
    ][3]
    t = np.frombuffer(base64.b64decode(curves["t"]), "<f4")
    assert (
        500 < len(t) <= POINTS_PER_CURVE
        and len(base64.b64decode(curves["nominal"])) == t.nbytes
    )


def test_the_summary_has_one_row_per_case(tmp_path: Path) -> None:
    made = [documents.two_effects(), documents.no_gap(), documents.unexplained()]
    rows = [
        Row(document["case"], f"cell {document['case']}", document) for document in made
    ]
    render_summary(
        [*rows, Row("broken", "broken", None, "a.csv, line 12: not a number")],
        tmp_path / "s.html",
    )
    page = Page((tmp_path / "s.html").read_text(encoding="utf-8"))
    assert [x for x in page.addresses if x != "#content"] == [
        f"./cell%20{document['case']}/report.html" for document in made
    ]
    for expected in (
        "4 cases",
        "Actuator delay",
        "joints 4 and 5",
        "96 %",
        "0.219",
        "No gap",
        "Failed",
        "line 12",
    ):
        assert expected in page.text


def test_where_the_gap_lies_as_pictures(tmp_path: Path) -> None:
    diagnosis = replace(
        documents.diagnosis(documents.two_effects()), located=(located("before"),)
    )
    told = curves(diagnosis)
    assert {picture["kind"] for picture in told} >= {"frequency"} and len(told) <= 3
    render(diagnosis, tmp_path / "report.html")
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    for index, picture in enumerate(told):
        assert f'data-place="{index}"' in html and picture["title"].startswith("J4")


def test_a_joint_left_above_its_floor_is_said_on_the_first_screen(
    tmp_path: Path,
) -> None:
    document = documents.two_effects()
    assert "Not all is explained" not in rendered(document, tmp_path).text
    times_floor = [0.7, 0.7, 0.7, 10.0, 0.7, 0.7, 0.7]
    document["verdict"] = "unexplained"
    document["unexplained"] |= {
        "above_floor": True,
        "joints": [4],
        "times_floor": times_floor,
    }
    text = rendered(document, tmp_path).text
    assert (
        "Not all is explained" in text
        and "Joint 4 is left at 10 times its floor" in text
    )
    assert "actuator delay may be a proxy for another cause" in text


def test_what_is_possible_has_its_own_block(tmp_path: Path) -> None:
    assert (
        "Possible, not confirmed"
        not in rendered(documents.two_effects(), tmp_path).text
    )
    page = rendered(documents.one_possible(), tmp_path)
    assert "Possible, not confirmed" in page.text
    assert "to confirm, record a rest" in page.text and "#possible" in page.addresses
