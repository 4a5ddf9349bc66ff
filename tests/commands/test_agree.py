"""The command agree: one line per parameter on the terminal, JSON, and a page."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator

import gapscope as package
from gapscope.arm.io.json_file import schema

Command = Callable[..., Any]


def check_against_schema(file: Path) -> dict[str, Any]:
    """The document in a file, valid by the schema that comes with the package."""
    content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    Draft202012Validator(schema("agreement")).validate(content)
    return content


def test_writes_page_and_document(
    gapscope: Command, healthy: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    done = gapscope("agree", healthy, "--out", out)
    assert done.code == 0, done.err
    text = " ".join(done.out.split())
    assert "0 differ" in text and "Coulomb friction of joint 2" in text
    assert f"wrote {out / 'agreement.html'}" in done.out
    content = check_against_schema(out / "agreement.json")
    assert content["recordings"] == [f"recording_{k}.csv" for k in range(3)]
    assert {one["verdict"] for one in content["parameters"]} <= {
        "agrees",
        "not determined",
    }
    page = (out / "agreement.html").read_text(encoding="utf-8")
    body = page.partition("<body>")[2]
    assert not re.search(r"<(script|img|link|iframe)[^>]*(src|href)=", page)
    assert "Plotly.newPlot" in body and "Coulomb friction of joint 2" in body


def test_prints_json(gapscope: Command, healthy: Path) -> None:
    done = gapscope("agree", healthy, "--json")
    assert done.code == 0, done.err
    content = json.loads(done.out)
    assert content["case"] == "healthy" and content["schema"] == 1


def test_differences_are_said_in_words_and_on_the_page(
    gapscope: Command, healthy: Path, sick: Path, tmp_path: Path
) -> None:
    """One recording of the healthy arm comes from the sick one, with more viscous friction on joint 2."""
    source = sick / "recording_1.csv"
    (healthy / "recording_1.csv").write_text(source.read_text(encoding="utf-8"))
    done = gapscope("agree", healthy, "--out", tmp_path / "out")
    text = " ".join(done.out.split())
    assert "viscous friction of joint 2 differs" in text
    assert "to settle it: repeat recording_1.csv" in text
    content = check_against_schema(tmp_path / "out" / "agreement.json")
    assert content["parameters"][0]["verdict"] == "differs"
    page = (tmp_path / "out" / "agreement.html").read_text(encoding="utf-8")
    assert "Viscous friction of joint 2 differs" in page


def test_python_interface_gives_the_same(healthy: Path) -> None:
    result = package.agree(healthy)
    frame = result.to_frame()
    assert set(frame["verdict"]) <= {"agrees", "not determined"}
    assert len(frame) == 3 * len(result.document["parameters"])
    assert "recordings" in result.summary()


def test_one_recording_is_refused(gapscope: Command, healthy: Path) -> None:
    case = healthy / "case.yaml"
    text = case.read_text(encoding="utf-8")
    kept = re.sub(r"^\s*- recording_[12]\.csv\n", "", text, flags=re.MULTILINE)
    kept = kept.replace(", recording_1.csv, recording_2.csv", "")
    assert kept != text
    case.write_text(kept, encoding="utf-8")
    done = gapscope("agree", healthy)
    assert done.code == 2
    assert "one recording agrees with itself" in " ".join(done.err.split())
    assert "remedy" in done.err
