"""Several cases at once: what is kept of an earlier run, what an interruption leaves, and that backends agree."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from guard import HANG
from sweeps import daily, nightly

from gapscope.diagnosis.diagnose_change import identify_reference
from gapscope.interface.diagnose import kept_reference
from gapscope.many.batch import Batch, finished
from gapscope.provenance import made_from

Command = Callable[..., Any]


@pytest.fixture
def other(sick: Path) -> Path:
    """Another unit that is like ``sick``."""
    return Path(shutil.copytree(sick, sick.parent / "other"))


def texts(out: Path) -> dict[str, bytes]:
    return {
        path.parent.name: path.read_bytes() for path in out.glob("*/diagnosis.json")
    }


def test_what_is_whole_and_unchanged_is_kept_and_units_are_compared(
    gapscope: Command,
    sick: Path,
    healthy: Path,
    other: Path,
    both_results: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out = both_results
    done = gapscope("diagnose", sick, healthy, "--out", out)
    assert done.out.count("kept from an earlier run") == 2
    shutil.copytree(out / "sick", out / "other")
    times = {path: path.stat().st_mtime_ns for path in out.glob("*/*")}
    done = gapscope("diagnose", sick, other, healthy, "--out", out)
    assert done.code == 0 and f"wrote {out / 'units.json'}" in done.out
    assert done.out.count("kept from an earlier run") == 3
    assert {path: path.stat().st_mtime_ns for path in out.glob("*/*")} == times
    (group,) = json.loads((out / "units.json").read_text(encoding="utf-8"))["groups"]
    (effect,) = group["effects"]
    place = effect["effect"], effect["joint"], effect["units"]
    assert place == ("viscous_friction", 2, ["sick", "other"])
    assert effect["kind"] == "some_units" and effect["agree"]
    assert group["nominal_differs"] == [] and group["confusion"]["left_out"] == {}
    alike = {"sick": ["other"], "other": ["sick"]}
    assert group["confusion"]["confused_with"] == alike | {"healthy": []}
    summary = (out / "summary.html").read_text(encoding="utf-8")
    assert "on 2 of 3 units, alike" in summary and "Which unit is this?" in summary
    assert "sick and other cannot be told apart" in done.out
    assert "sick (other): Effects found" in done.out and "sick (other)" in summary
    assert json.loads(texts(out)["healthy"])["verdict"] == "no_gap"
    monkeypatch.setattr("gapscope.provenance.program", lambda: "another")
    assert finished(sick, out / "sick") is None


def test_what_changed_is_done_again_and_a_fault_of_the_program_stops_no_other_case(
    gapscope: Command,
    sick: Path,
    healthy: Path,
    both_results: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from gapscope.interface import diagnose as run

    whole, out, first = run.diagnose_case, both_results, texts(both_results)

    def faulty(case: Any, progress: Any) -> Any:
        if case.name == "sick":
            raise ZeroDivisionError("by chance")
        return whole(case, progress)

    monkeypatch.setattr(run, "diagnose_case", faulty)
    with (sick / "recording_1.csv").open("a", encoding="utf-8") as file:
        file.write("\n")
    for more, kept in (((), 1), (("--again",), 0)):
        done = gapscope("diagnose", sick, healthy, "--out", out, *more)
        assert done.code == 1 and "ZeroDivisionError: by chance" in done.out
        assert done.out.count("kept from an earlier run") == kept
        assert texts(out) == {"healthy": first["healthy"]}


@pytest.mark.parametrize(
    ("law", "taken"),
    [("saturating_friction", True), nightly("viscous_friction", False)],
)
def test_a_unit_has_the_law_of_its_type_where_that_explains_as_much(
    gapscope: Command,
    sick: Path,
    results: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    law: str,
    taken: bool,
) -> None:
    """What is found with friction that is viscous, without it and without another law."""
    out = tmp_path / "out"
    for name in ("sick", "twin"):
        shutil.copytree(results, out / name)
    module = "gapscope.many.batch.other_laws"
    monkeypatch.setattr(module, lambda documents: {"sick": (law,)})
    twin = shutil.copytree(sick, sick.parent / "twin")
    done = gapscope("diagnose", sick, twin, "--out", out)
    assert done.code == 0 and done.out.count("kept from an earlier run") == 2
    assert ("friction law of its type" in done.out) is taken
    document = json.loads(texts(out)["sick"])
    assert document["effects"][0]["effect"] == "viscous_friction"
    assert {path.name for path in out.iterdir() if path.is_dir()} == {"sick", "twin"}
    assert finished(sick, out / "sick") is not None


def test_cases_are_compared_with_a_reference_that_is_identified_once(
    gapscope: Command,
    sick: Path,
    healthy: Path,
    other: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    identified = []

    def counted(*arguments: Any) -> Any:
        identified.append(arguments)
        return identify_reference(*arguments)

    monkeypatch.setattr("gapscope.interface.diagnose.identify_reference", counted)
    out = tmp_path / "out"
    arguments = ("diagnose", sick, other, "--against", healthy, "--out", out)
    assert gapscope(*arguments).code == 0
    assert len(identified) == 1
    assert (out / "identified" / "reference.json").is_file()
    for name in ("sick", "other"):
        document = json.loads((out / name / "diagnosis.json").read_text("utf-8"))
        assert document["against"]["reference"] == "healthy"
        assert [e["effect"] for e in document["effects"]] == ["viscous_friction"]
        assert (out / name / "identified_case.yaml").is_file()
    units = json.loads((out / "units.json").read_text(encoding="utf-8"))
    alike = {"sick": ["other"], "other": ["sick"]}
    assert units["groups"][0]["confusion"]["confused_with"] == alike

    done = gapscope(*arguments)
    assert done.code == 0 and done.out.count("kept from an earlier run") == 2
    assert len(identified) == 1
    # without the reference, or with another one, it is another diagnosis
    reference = {"case_sha256": "another"}
    assert finished(sick, out / "sick") is None
    assert finished(sick, out / "sick", reference) is None

    # a reference whose files changed is identified again
    with (healthy / "recording_1.csv").open("a", encoding="utf-8") as file:
        file.write("\n")
    kept_reference(healthy, out)
    assert len(identified) == 2


@pytest.mark.parametrize("damage", ["half", "no report", "not of this program"])
def test_what_is_not_whole_is_done_again(
    sick: Path, results: Path, damage: str
) -> None:
    assert finished(sick, results) is not None
    file = results / "diagnosis.json"
    text = file.read_text(encoding="utf-8")
    if damage == "no report":
        (results / "report.html").unlink()
    else:
        half, others = text[: len(text) // 2], text.replace("made_from", "by_another")
        file.write_text(half if damage == "half" else others, encoding="utf-8")
    assert finished(sick, results) is None


def test_moving_a_case_does_not_matter_changing_a_file_does(
    sick: Path, tmp_path: Path
) -> None:
    moved = Path(shutil.copytree(sick, tmp_path / "elsewhere" / "sick"))
    assert made_from(sick) == made_from(moved) == made_from(moved / "case.yaml")
    urdf = next(moved.glob("*.urdf"))
    urdf.write_text(urdf.read_text() + "\n")
    assert made_from(sick) != made_from(moved)


def heeding_interrupts() -> None:
    """Undo that a test run in the background ignores SIGINT, which its children would inherit."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.slow
@pytest.mark.skipif(
    sys.platform == "win32", reason="sends SIGINT to a group of processes"
)
@pytest.mark.parametrize("jobs", daily(("1", "2"), "1"))
def test_interrupted_says_how_to_go_on_and_leaves_nothing_half(
    gapscope: Command, sick: Path, healthy: Path, tmp_path: Path, jobs: str
) -> None:
    # behind the first there is much to do, so that a busy machine does not end before it is told to
    out, more = tmp_path / "out", shutil.copytree(sick, tmp_path / "more")
    cases = [healthy, sick, more]
    command = [sys.executable, "-m", "gapscope", "diagnose", *map(str, cases)]
    command += ["--out", str(out), "--jobs", jobs]
    aside = tmp_path / "aside"
    aside.mkdir()
    running = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=heeding_interrupts,
        env=os.environ | {"TMPDIR": str(aside)},
    )
    end = time.monotonic() + HANG
    while not texts(out) and time.monotonic() < end and running.poll() is None:
        time.sleep(0.01)
    # a terminal interrupts all processes, a supervisor asks one to end
    if jobs == "1":
        os.killpg(running.pid, signal.SIGINT)
    else:
        running.terminate()
    _, said = running.communicate(timeout=HANG)
    assert running.returncode == 130, said
    # a worker that is interrupted while it starts may tell of itself; the command does not
    assert "run the same command again" in said and "cli.py" not in said
    assert not (out / "summary.html").exists() and not list(aside.iterdir())
    before = texts(out)
    assert before and all(json.loads(text) for text in before.values())
    done = gapscope("diagnose", *cases, "--out", out)
    assert done.code == 0 and done.out.count("kept from an earlier run") == len(before)
    assert (out / "summary.html").is_file()


def test_results_have_the_names_of_their_cases(tmp_path: Path) -> None:
    """Numbered beside one that has the number; a dot in the name of a folder is no ending."""
    one_name = tuple(Path(x) / "case.yaml" for x in ("a-3", "one/a", "two/a"))
    assert list(Batch(one_name, Path("out")).by_folder) == ["a-3", "a", "a-4"]
    cases = tuple(tmp_path / name for name in ("arm.v1", "arm.v2", "arm_2026.03.14"))
    for case in cases:
        case.mkdir()
    files = (cases[0] / "case.yaml", *cases[1:], tmp_path / "b.yaml")
    found = Batch(files, Path("out")).by_folder
    assert list(found) == [*(case.name for case in cases), "b"]
    assert list(found.values()) == list(files)
