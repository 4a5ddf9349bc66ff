"""The command line: what it writes, and 0, 1 or 2 with a message that names the fault."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gapscope.arm.case import load_case
from gapscope.arm.io.load_recording import load_recording
from gapscope.cli import SECTIONS, main
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.gap.predict import predict_torque
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import read_corrected

Command = Callable[..., Any]
RESULTS = ["corrected.yaml", "diagnosis.json", "report.html"]
PREDICT = "predict {sick} --recording {sick}/recording_0.csv"


def files(folder: Path) -> list[str]:
    """Everything in a folder, hidden files included."""
    return sorted(
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.is_file()
    )


def replace(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def test_help_lists_the_commands_and_each_has_its_own(gapscope: Command) -> None:
    done = gapscope("--help")
    assert all(f"{section}:" in done.out for section in SECTIONS)
    listed = re.findall(r"(?m)^  ([a-z]+)  ", done.out)
    assert {"diagnose", "predict", "gap", "demo", "blind"} <= set(listed)
    assert len(listed) == len(set(listed)) and "..." not in done.out.split("\n", 1)[1]
    for command in listed:
        done = gapscope(command, "--help")
        assert done.code == 0 and done.out.strip()


def test_says_its_version(gapscope: Command) -> None:
    assert gapscope("--version").out.split() == ["gapscope", version("gapscope")]


def test_diagnose_writes_three_files_and_names_them(diagnosed: Any) -> None:
    assert files(diagnosed.out) == RESULTS
    found = diagnosed.document
    validate(found)
    assert found["case"] == "sick" and found["verdict"] == "effects_found"
    (entry,) = found["effects"]
    assert (entry["effect"], entry["joints"]) == ("viscous_friction", [2])
    value = entry["parameters"]["coefficient"]["value"]
    assert value == pytest.approx([3.0], rel=0.05)
    (effect,) = read_corrected(diagnosed.out / "corrected.yaml")
    assert effect.parameters["coefficient"] == pytest.approx(value)
    assert all(f"wrote {diagnosed.out / name}" in diagnosed.said for name in RESULTS)
    assert "Viscous friction" in diagnosed.said and "sick: " in diagnosed.said


@pytest.mark.parametrize(
    ("stop", "place"),
    [
        (KeyboardInterrupt, "interface.diagnose.write_document"),
        (MemoryError, "effects.corrected_file.yaml.safe_dump"),
    ],
)
def test_interrupted_run_leaves_no_diagnosis(
    healthy: Path,
    both_results: Path,
    monkeypatch: pytest.MonkeyPatch,
    stop: type[BaseException],
    place: str,
) -> None:
    """That of an earlier run is gone, and so is every file that was begun; others are whole."""
    results = both_results / "healthy"
    before = (results / "corrected.yaml").read_bytes()

    def interrupted(*_: object, **__: object) -> None:
        raise stop

    monkeypatch.setattr(f"gapscope.{place}", interrupted)
    with pytest.raises(BaseException) as ended:
        main(["diagnose", str(healthy), "--out", str(results)])
    assert not (results / "diagnosis.json").exists()
    assert set(files(results)) <= set(RESULTS)
    assert (results / "corrected.yaml").read_bytes() == before
    if stop is KeyboardInterrupt:
        assert isinstance(ended.value, SystemExit) and ended.value.code == 130


def test_work_that_fails_leaves_no_diagnosis_of_an_earlier_run(
    gapscope: Command, sick: Path, results: Path
) -> None:
    with (sick / "case.yaml").open("a") as file:
        file.write("import: {tau: null}\n")
    for arguments in (("gap", sick), ("diagnose", sick, "--out", results)):
        done = gapscope(*arguments)
        assert done.code == 1 and "sick: no recording carries a torque" in done.err
        assert "give torque with its sign in column tau1.." in done.err
    assert not (results / "diagnosis.json").exists()


UNWRITABLE = {
    "diagnose": ("file/out", "diagnose {sick} --out {out}", "--out"),
    "diagnose several": ("file/out", "diagnose {sick} {healthy} --out {out}", ""),
    "predict": ("file/tau.csv", f"{PREDICT} --out {{out}}", "cannot be written"),
    "predict on a folder": (
        "folder.csv",
        f"{PREDICT} --out {{out}}",
        "cannot be written",
    ),
    "demo": ("file/demo", "demo --out {out} --seed 1", ""),
    "document is a folder": ("out", "diagnose {sick} --out {out}", "diagnosis.json"),
}


@pytest.mark.parametrize("what", UNWRITABLE)
def test_what_cannot_be_written_is_said(
    gapscope: Command, sick: Path, healthy: Path, tmp_path: Path, what: str
) -> None:
    """Exit code 1: the work failed and says why."""
    name, command, said = UNWRITABLE[what]
    (tmp_path / "file").touch()
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "out" / "diagnosis.json").mkdir(parents=True)
    places = {"sick": sick, "healthy": healthy, "out": tmp_path / name}
    done = gapscope(*(part.format(**places) for part in command.split()))
    assert done.code == 1 and str(tmp_path / name) in done.err and said in done.err
    assert files(tmp_path / "folder.csv") == []
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_gap_as_json_and_as_a_table(
    gapscope: Command, sick: Path, corrected: Path
) -> None:
    found = json.loads(gapscope("gap", sick, "--json").out)
    assert found["case"] == "sick" and found["joints"] == ["yaw", "pitch"]
    names = [row["recording"] for row in found["recordings"]]
    assert names == [f"recording_{k}.csv" for k in range(3)]
    after = json.loads(gapscope("gap", sick, "--json", "--model", corrected).out)
    pairs = zip(found["recordings"], after["recordings"], strict=True)
    for before_row, after_row in pairs:
        (yaw, pitch), (yaw_after, pitch_after) = (
            row["torque_nrmse"] for row in (before_row, after_row)
        )
        assert before_row["role"] == "fit"
        assert pitch > 0.1 > 0.03 > pitch_after
        assert yaw == pytest.approx(yaw_after)
    done = gapscope("gap", sick)
    assert done.code == 0 and "recording_2.csv" in done.out and "J2" in done.out


def table(path: Path) -> tuple[list[str], np.ndarray]:
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    return header, np.array(rows, dtype=float)


@pytest.fixture
def predicted(gapscope: Command, sick: Path, tmp_path: Path) -> Command:
    """Runs ``predict`` on a recording, with a model or without."""

    def call(recording: Path, *model: object) -> Any:
        out = tmp_path / "deep" / "tau.csv"
        more = ("--recording", recording, "--out", out)
        return gapscope("predict", sick, *more, *model), out

    return call


def test_prediction_has_columns_and_rows_and_the_model_makes_a_difference(
    predicted: Command, sick: Path, corrected: Path
) -> None:
    source = sick / "recording_1.csv"
    _, out = predicted(source)
    _, nominal = table(out)
    done, out = predicted(source, "--model", corrected)
    assert done.code == 0 and f"wrote {out}" in done.out
    header, rows = table(out)
    assert header == ["t", "tau1", "tau2"] and files(out.parent) == ["tau.csv"]
    case = load_case(sick)
    recording = load_recording(source, case.arm)
    assert rows.shape == (1501, 3) and np.isfinite(rows).all()
    np.testing.assert_array_equal(rows[:, 0], recording.t)
    arm = CorrectedArm(case.arm, read_corrected(corrected))
    np.testing.assert_array_equal(rows[:, 1:], predict_torque(arm, recording))
    np.testing.assert_array_equal(nominal[:, 1], rows[:, 1])
    assert np.abs(nominal[:, 2] - rows[:, 2]).max() > 1.0


def test_prediction_for_a_recording_with_t_and_q_alone(
    predicted: Command, sick: Path, tmp_path: Path
) -> None:
    """The rows of the file, repeated ones included, and the recordings of the case are not needed."""
    header, rows = table(sick / "recording_1.csv")
    few = rows[:, [header.index(name) for name in ("t", "q1", "q2")]]
    few = np.insert(few, 100, few[100], axis=0)
    form = {"delimiter": ",", "header": "t,q1,q2", "comments": "", "fmt": "%.17g"}
    np.savetxt(tmp_path / "few.csv", few, **form)
    for path in sick.glob("recording_*.csv"):
        path.unlink()
    done, out = predicted(tmp_path / "few.csv")
    assert done.code == 0
    _, made = table(out)
    assert made.shape == (1502, 3) and np.isfinite(made).all()
    np.testing.assert_array_equal(made[100], made[101])


def test_a_bad_case_does_not_stop_the_others(
    gapscope: Command, sick: Path, healthy: Path, both_results: Path
) -> None:
    """Nor does it leave the diagnosis of an earlier run."""
    out = both_results
    replace(healthy / "recording_1.csv", "tau2", "torque2")
    done = gapscope("diagnose", sick, healthy, "--out", out)
    assert done.code == 2
    assert files(out / "sick") == RESULTS
    assert not (out / "healthy" / "diagnosis.json").exists()
    summary = (out / "summary.html").read_text(encoding="utf-8")
    assert all(word in summary for word in ("sick", "healthy", "tau2"))
    assert f"wrote {out / 'summary.html'}" in done.out
    assert "healthy: " in done.out and "tau2" in done.out
