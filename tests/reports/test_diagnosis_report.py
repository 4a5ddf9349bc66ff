"""The report: one file that says what was found, loads nothing, escapes names, and draws offline."""

from __future__ import annotations

import base64
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
from gapscope.diagnosis.result import Diagnosis, Located, Spectrum
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
    """Addresses and tags of a page, and its text."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.html = path.read_text(encoding="utf-8")
        self.addresses: list[str | None] = []
        self.tags: list[str] = []
        self.words: list[str] = []
        self.feed(self.html)
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        loads = ("src", "href", "srcset", "action")
        self.addresses += [value for name, value in attrs if name in loads]

    def handle_data(self, data: str) -> None:
        if self.tags and self.tags[-1] not in ("script", "style"):
            self.words.append(data)


def located(stage: str) -> Located:
    """A joint whose gap is large at one place, in one interval, and hums."""
    t = np.arange(5000) / 250.0
    q = np.column_stack([np.sin(0.9 * t + j) + 0.3 * np.sin(2.3 * t) for j in range(7)])
    dq = np.gradient(q, 1 / 250, axis=0)
    ddq = np.gradient(dq, 1 / 250, axis=0)
    one = np.zeros(5000, dtype=int)
    rows = MotionRows(t, q, dq, ddq, one, (250.0,), ("recording_a.csv",))
    white = np.random.default_rng(0).standard_normal((5000, 7))
    hum = 0.8 * np.sin(2 * np.pi * 6 * t) * (t > 12)
    error = 0.05 * white + (np.abs(q) < 0.2) * white + hum[:, None]
    return Located(stage, locate(error[:, 3], rows, 9 * np.cos(q), 0.05, 4))


@pytest.fixture
def rendered(tmp_path: Path) -> Callable[..., Page]:
    """The report of a document, or of a diagnosis."""

    def made(of: Any) -> Page:
        path = tmp_path / "report.html"
        render(documents.diagnosis(of) if isinstance(of, dict) else of, path)
        return Page(path)

    return made


@pytest.mark.parametrize(
    "make",
    [documents.two_effects, documents.no_gap, documents.unexplained, documents.changed],
)
def test_one_file_that_loads_nothing(make, rendered, tmp_path) -> None:
    page = rendered(make())
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]
    assert verdict_sentence(make()) in page.text
    assert "link" not in page.tags and "iframe" not in page.tags
    # addresses lead to a place on the page
    assert page.addresses and {address[0] for address in page.addresses} == {"#"}
    missing = [x for x in page.addresses if f'id="{x[1:]}"' not in page.html]
    assert not missing


def test_effects_are_given_on_only_where_no_cause_is_missing(rendered) -> None:
    offer, look = "Give the effects found", "Look at what stays unexplained"
    known = documents.two_effects()
    text = rendered(known).text
    assert offer in text and look not in text
    text = rendered(documents.unexplained() | {"effects": known["effects"]}).text
    assert look in text and offer not in text


def test_commands_name_the_files_of_the_case(rendered, tmp_path) -> None:
    known, file = documents.diagnosis(documents.two_effects()), "my arm/case.yaml"
    page = rendered(replace(known, case_file=Path(file)))
    assert f"{tmp_path}/corrected.yaml --case &#39;{file}&#39;" in page.html


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
def test_the_findings_are_in_the_report(make, findings, rendered) -> None:
    page = rendered(make())
    assert not [said for said in findings if said not in page.text]
    assert ("#against" in page.addresses) == (make is documents.changed)


def test_without_optional_keys_and_without_curves(rendered) -> None:
    document = documents.two_effects()
    optional = "arm recordings conditioning warnings where considered judged_on"
    for key in optional.split():
        del document[key]
    document["next_recording"] = None
    for stage in ("before", "after"):
        document["gap"][stage]["replay_rmse"] = None
    empty = Spectrum(np.zeros(0), np.zeros((0, 7)), np.zeros((0, 7)))
    effects = documents.diagnosis(documents.two_effects()).effects
    text = rendered(Diagnosis(document, effects, (), (), empty)).text
    assert "Torque over time" not in text and "Replay RMSE before" not in text
    assert "None needed" in text


def test_effects_outside_the_catalogue_are_shown(rendered) -> None:
    document = documents.two_effects()
    document["effects"][0]["effect"] = "joint_swap"
    assert "Joint swap" in rendered(document).text


def test_names_are_escaped(rendered, tmp_path) -> None:
    document = documents.two_effects()
    document |= dict.fromkeys(("case", "next_recording", "judged_on"), EVIL)
    document["warnings"] = [EVIL]
    joints = [EVIL + str(number) for number in range(7)]
    document["arm"] = {"robot": EVIL, "joints": joints}
    document["recordings"][0]["name"] = EVIL
    document["where"][0]["regime"] = document["considered"][0]["reason"] = EVIL
    page = rendered(document)
    assert EVIL not in page.html
    assert "img" not in page.tags and page.tags.count("script") == 3
    rows = [Row(EVIL, EVIL, document), Row(EVIL, "b", None, EVIL)]
    render_summary(rows, tmp_path / "summary.html")
    summary = Page(tmp_path / "summary.html")
    assert "script" not in summary.tags and "img" not in summary.tags


def test_curves_are_thinned_but_keep_their_peaks() -> None:
    series = np.sin(np.linspace(0.0, 9.0, 60_000))
    series[41_234] = 7.0
    keep = keep_extremes([series, -series], 1000)
    assert len(keep) <= 1000 and series[keep].max() == 7.0 and np.all(np.diff(keep) > 0)
    assert np.array_equal(keep_extremes([series[:9]], 1000), np.arange(9))
    drawn = payload(documents.diagnosis(documents.two_effects()))
    joint = drawn["recordings"][0]["joints"][3]
    t, nominal = (base64.b64decode(joint[key]) for key in ("t", "nominal"))
    assert 500 < len(t) / 4 <= POINTS_PER_CURVE and len(nominal) == len(t)


def test_the_summary_has_one_row_per_case(tmp_path) -> None:
    made = [documents.two_effects(), documents.no_gap(), documents.unexplained()]
    names = [document["case"] for document in made]
    rows = [Row(name, f"cell {name}", x) for name, x in zip(names, made, strict=True)]
    broken = Row("broken", "broken", None, "a.csv, line 12: not a number")
    render_summary([*rows, broken], tmp_path / "s.html")
    page = Page(tmp_path / "s.html")
    links = [f"./cell%20{name}/report.html" for name in names]
    assert [x for x in page.addresses if x != "#content"] == links
    words = ("4 cases", "Actuator delay", "joints 4 and 5", "96 %", "0.219", "No gap")
    assert not [x for x in (*words, "Failed", "line 12") if x not in page.text]


def test_where_the_gap_lies_as_pictures(rendered) -> None:
    known = documents.diagnosis(documents.two_effects())
    diagnosis = replace(known, located=(located("before"),))
    told = curves(diagnosis)
    assert {picture["kind"] for picture in told} >= {"frequency"} and len(told) <= 3
    html = rendered(diagnosis).html
    for index, picture in enumerate(told):
        assert f'data-place="{index}"' in html and picture["title"].startswith("J4")


def test_a_joint_left_above_its_floor_is_said_on_the_first_screen(rendered) -> None:
    document = documents.two_effects()
    assert "Not all is explained" not in rendered(document).text
    left = {"joints": [4], "times_floor": [*[0.7] * 3, 10.0, *[0.7] * 3]}
    document["verdict"] = "unexplained"
    document["unexplained"] |= {"above_floor": True, **left}
    text = rendered(document).text
    assert "Not all is explained" in text
    assert "Joint 4 is left at 10 times its floor" in text
    assert "actuator delay may be a proxy for another cause" in text


def test_what_is_possible_has_its_own_block(rendered) -> None:
    block = "Possible, not confirmed"
    assert block not in rendered(documents.two_effects()).text
    page = rendered(documents.one_possible())
    assert block in page.text and "#possible" in page.addresses
    assert "to confirm, record a rest" in page.text
