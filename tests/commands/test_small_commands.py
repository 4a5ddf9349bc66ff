"""The commands advise, agree, audit, export and serve: what they print and write."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from cases import valid_document

import gapscope as package
from gapscope.arm.motions.trajectory import read_sampled
from gapscope.arm.robots import load_nominal_arm
from gapscope.many.archive import ArchiveServer

Command = Callable[..., Any]
QUICK = ("--evaluations", 30, "--seed", 1, "--no-collisions", "--singular", 0)


def test_an_open_question_gets_a_recording(
    gapscope: Command, sick: Path, open_question: Path, tmp_path: Path
) -> None:
    out = tmp_path / "next.csv"
    done = gapscope("advise", sick, "--diagnosis", open_question, "--out", out, *QUICK)
    assert done.code == 0, done.err
    endings = (".csv", ".yaml", ".html", "_slow.csv", "_slow.yaml")
    names = [tmp_path / f"next{ending}" for ending in endings]
    assert done.out.splitlines()[-5:] == [f"wrote {path}" for path in names]
    assert all(path.is_file() for path in names)
    rivals = "viscous friction (joint 2), or Coulomb friction (joint 2)"
    assert f"Still open: {rivals}" in done.said
    assert "the new recording is expected to give an evidence of" in done.said
    assert "Least margin to each limit" in done.out
    assert read_sampled(out, 2).duration >= 10.0


def test_nothing_open_is_said_and_nothing_written(
    gapscope: Command, healthy: Path, tmp_path: Path
) -> None:
    done = gapscope("advise", healthy, "--out", tmp_path / "next.csv", *QUICK)
    assert done.code == 0 and "Nothing is open" in done.out
    assert not list(tmp_path.glob("next.*"))


def test_agreement_as_page_document_and_frame(
    gapscope: Command, healthy: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    done = gapscope("agree", healthy, "--out", out)
    assert done.code == 0, done.err
    assert "0 differ" in done.said and "Coulomb friction of joint 2" in done.said
    assert f"wrote {out / 'agreement.html'}" in done.out
    content = valid_document(out / "agreement.json")
    assert content["recordings"] == [f"recording_{k}.csv" for k in range(3)]
    page = (out / "agreement.html").read_text(encoding="utf-8")
    body = page.partition("<body>")[2]
    assert not re.search(r"<(script|img|link|iframe)[^>]*(src|href)=", page)
    assert "Plotly.newPlot" in body and "Coulomb friction of joint 2" in body
    result = package.agree(healthy)
    frame = result.to_frame()
    assert set(frame["verdict"]) <= {"agrees", "not determined"}
    assert len(frame) == 3 * len(content["parameters"])
    assert "recordings" in result.summary()


def test_differences_are_said_in_words_and_on_the_page(
    gapscope: Command, healthy: Path, sick: Path, tmp_path: Path
) -> None:
    """One recording of the healthy arm comes from the sick one, with more viscous friction on joint 2."""
    source = sick / "recording_1.csv"
    (healthy / "recording_1.csv").write_text(source.read_text(encoding="utf-8"))
    done = gapscope("agree", healthy, "--out", tmp_path / "out")
    assert "viscous friction of joint 2 differs" in done.said
    assert "to settle it: repeat recording_1.csv" in done.said
    content = valid_document(tmp_path / "out" / "agreement.json")
    assert content["parameters"][0]["verdict"] == "differs"
    page = (tmp_path / "out" / "agreement.html").read_text(encoding="utf-8")
    assert "Viscous friction of joint 2 differs" in page


def test_audit_of_a_robot_and_of_a_case(
    gapscope: Command, sick: Path, tmp_path: Path
) -> None:
    """The worst first; files only on request."""
    done = gapscope("audit", "kuka_iiwa")
    assert done.code == 0 and "wrote" not in done.out
    assert "7 moving joints" in done.out
    assert done.out.index("missing: ") < done.out.index("note: ")
    done = gapscope("audit", sick, "--out", tmp_path / "out")
    assert done.code == 0, done.err
    content = json.loads((tmp_path / "out" / "audit.json").read_text())
    assert content["robot"] == "two" and content["total_mass"] == 8
    page = (tmp_path / "out" / "audit.html").read_text()
    assert "What is odd about two" in page and "https:" not in page


@pytest.mark.parametrize("command", ["agree", "audit"])
def test_prints_json_alone(gapscope: Command, healthy: Path, command: str) -> None:
    done = gapscope(command, healthy, "--json")
    assert done.code == 0, done.err
    assert isinstance(json.loads(done.out), dict)


@pytest.mark.parametrize("form", ["urdf", "mjcf", "sdf", "mjlab"])
def test_writes_the_arm_of_a_case(
    gapscope: Command, sick: Path, corrected: Path, tmp_path: Path, form: str
) -> None:
    out = tmp_path / "new" / f"arm.{form}"
    done = gapscope("export", corrected, "--case", sick, "--format", form, "--out", out)
    assert done.code == 0, done.err
    assert done.out.splitlines()[-1] == f"wrote {out}"
    told = "left out of" in done.out and "armature" in done.out
    assert told == (form in ("urdf", "sdf"))
    assert [path.name for path in out.parent.iterdir()] == [out.name]
    if form == "urdf":
        assert load_nominal_arm(out).viscous == pytest.approx([1.0, 4.0])
    if form == "mjlab":
        assert "viscous_damping=4.0" in out.read_text(encoding="utf-8")


def interrupted(self, poll_interval: float = 0.5) -> None:
    raise KeyboardInterrupt


def test_it_says_where_it_is_and_ends_with_ctrl_c(
    gapscope: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ArchiveServer, "serve_forever", interrupted)
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "diagnosis.json").write_text(json.dumps({"half": 1}))
    outcome = gapscope("serve", tmp_path)
    assert outcome.code == 0
    said, ended = outcome.out.splitlines()
    assert said.startswith("1 diagnosis at http://127.0.0.1:") and ended == "stopped"
