"""The command line: what it writes, and 0, 1 or 2 with a message that names the fault."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from guard import HANG

from gapscope.arm.case import load_case
from gapscope.arm.io.load_recording import load_recording
from gapscope.cli import SECTIONS, main
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.gap.predict import predict_torque
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import read_corrected

Command = Callable[..., Any]
RESULTS = ["corrected.yaml", "diagnosis.json", "report.html"]


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


class TestHelp:
    def test_lists_the_commands(self, gapscope: Command) -> None:
        done = gapscope("--help")
        assert done.code == 0
        assert all(f"{section}:" in done.out for section in SECTIONS)
        listed = re.findall(r"(?m)^  ([a-z]+)  ", done.out)
        assert {"diagnose", "predict", "gap", "demo", "blind"} <= set(listed)
        assert (
            len(listed) == len(set(listed)) and "..." not in done.out.split("\n", 1)[1]
        )

    @pytest.mark.parametrize("command", ["diagnose", "predict", "gap", "demo"])
    def test_of_each_command(self, gapscope: Command, command: str) -> None:
        done = gapscope(command, "--help")
        assert done.code == 0 and done.out.strip()

    def test_installed_command(self) -> None:
        done = subprocess.run(
            [sys.executable, "-c", "from gapscope.cli import main; main()", "--help"],
            capture_output=True,
            text=True,
            timeout=HANG,
            check=False,
        )
        assert done.returncode == 0 and "diagnose" in done.stdout

    @pytest.mark.parametrize(
        "arguments",
        [
            ["diagnos"],
            ["diagnose"],
            ["gap"],
            ["gap", "case", "--jsn"],
            ["predict", "c"],
        ],
    )
    def test_wrong_usage_is_bad_input(
        self, gapscope: Command, arguments: list[str]
    ) -> None:
        assert gapscope(*arguments).code == 2


class TestDiagnose:
    def test_writes_three_files_and_names_them(
        self, gapscope: Command, sick: Path, tmp_path: Path
    ) -> None:
        out = tmp_path / "new" / "out"
        done = gapscope("diagnose", sick, "--out", out)
        assert done.code == 0
        assert files(out) == RESULTS
        document = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
        validate(document)
        assert document["case"] == "sick" and document["verdict"] == "effects_found"
        assert [(e["effect"], e["joints"]) for e in document["effects"]] == [
            ("viscous_friction", [2])
        ]
        assert document["effects"][0]["parameters"]["coefficient"][
            "value"
        ] == pytest.approx([3.0], rel=0.05)
        (effect,) = read_corrected(out / "corrected.yaml")
        assert effect.parameters["coefficient"] == pytest.approx([3.0], rel=0.05)
        assert all(f"wrote {out / name}" in done.out for name in RESULTS)
        assert "viscous" in done.out.lower() and "sick: " in done.err

    def test_case_file_instead_of_folder(
        self, gapscope: Command, healthy: Path, tmp_path: Path
    ) -> None:
        assert (
            gapscope("diagnose", healthy / "case.yaml", "--out", tmp_path / "out").code
            == 0
        )
        document = json.loads(
            (tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8")
        )
        assert document["verdict"] == "no_gap"
        assert read_corrected(tmp_path / "out" / "corrected.yaml") == ()

    @pytest.mark.parametrize("stop", [KeyboardInterrupt, MemoryError])
    def test_interrupted_run_leaves_no_diagnosis(
        self,
        sick: Path,
        results: Path,
        monkeypatch: pytest.MonkeyPatch,
        stop: type[BaseException],
    ) -> None:
        """That of an earlier run is gone, and so is every file that was begun."""

        def interrupted(*_: object) -> None:
            raise stop

        monkeypatch.setattr("gapscope.reports.diagnosis.write_document", interrupted)
        with pytest.raises(BaseException) as ended:
            main(["diagnose", str(sick), "--out", str(results)])
        assert not (results / "diagnosis.json").exists()
        assert set(files(results)) <= set(RESULTS)
        if stop is KeyboardInterrupt:
            assert isinstance(ended.value, SystemExit) and ended.value.code == 130

    def test_interrupted_while_it_writes_leaves_the_file_before(
        self,
        gapscope: Command,
        sick: Path,
        results: Path,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        before = (results / "corrected.yaml").read_bytes()

        def interrupted(*_: object, **__: object) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(
            "gapscope.effects.corrected_file.yaml.safe_dump", interrupted
        )
        assert gapscope("diagnose", sick, "--out", results).code == 130
        assert (results / "corrected.yaml").read_bytes() == before
        assert set(files(results)) <= set(RESULTS)
        assert not (results / "diagnosis.json").exists()

    def test_failed_run_leaves_no_diagnosis_of_an_earlier_one(
        self, gapscope: Command, sick: Path, results: Path
    ) -> None:
        for name in ("recording_0.csv", "recording_1.csv", "recording_2.csv"):
            shortened(name)(sick)
        assert gapscope("diagnose", sick, "--out", results).code == 2
        assert not (results / "diagnosis.json").exists()

    def test_unreadable_case_leaves_no_diagnosis_of_an_earlier_run(
        self, gapscope: Command, sick: Path, results: Path
    ) -> None:
        (sick / "robot.urdf").unlink()
        assert gapscope("diagnose", sick, "--out", results).code == 2
        assert not (results / "diagnosis.json").exists()


Spoil = Callable[[Path], object]


def removed(name: str) -> Spoil:
    return lambda case: (case / name).unlink()


def replaced(name: str, old: str, new: str) -> Spoil:
    return lambda case: replace(case / name, old, new)


def written(name: str, text: str) -> Spoil:
    return lambda case: (case / name).write_text(text)


def without_numbers(case: Path) -> None:
    lines = (case / "recording_2.csv").read_text().splitlines()
    for k in range(7, 307):
        lines[k] = lines[k].replace(lines[k].split(",")[1], "oops")
    (case / "recording_2.csv").write_text("\n".join(lines))


def shortened(name: str) -> Spoil:
    def spoil(case: Path) -> None:
        lines = (case / name).read_text().splitlines(keepends=True)
        (case / name).write_text("".join(lines[:200]))

    return spoil


BAD_CASES: dict[str, tuple[Spoil, tuple[str, ...]]] = {
    "missing case": (shutil.rmtree, ("sick", "no such file", "case.yaml")),
    "missing recording": (
        removed("recording_1.csv"),
        ("sick/recording_1.csv", "no such file"),
    ),
    "missing column": (
        replaced("recording_1.csv", "tau2", "torque2"),
        ("sick/recording_1.csv", "tau2"),
    ),
    "broken URDF": (
        written("robot.urdf", "<robot><link name='base'>"),
        ("sick/robot.urdf", "not valid XML"),
    ),
    "URDF without links": (written("robot.urdf", "<robot name='r'/>"), ("sick",)),
    "missing URDF": (removed("robot.urdf"), ("sick/robot.urdf",)),
    "joint that the URDF lacks": (
        replaced("case.yaml", "pitch", "elbow"),
        ("sick/case.yaml", "elbow", "yaw, pitch"),
    ),
    "cells that are no numbers": (without_numbers, ("recording_2.csv", "line 8", "q1")),
    "too short": (shortened("recording_0.csv"), ("recording_0.csv", "least 1 s")),
}


@pytest.mark.parametrize("what", BAD_CASES)
def test_a_bad_case_is_refused_with_file_and_place(
    gapscope: Command, sick: Path, tmp_path: Path, what: str
) -> None:
    """Exit code 2, and a message with file, place and remedy."""
    spoil, words = BAD_CASES[what]
    spoil(sick)
    out = tmp_path / "out"
    for arguments in (("diagnose", sick, "--out", out), ("gap", sick)):
        done = gapscope(*arguments)
        assert done.code == 2
        assert "Traceback" not in done.err and done.err.splitlines()[-1]
        assert all(word in done.err for word in words), done.err
    assert not (out / "diagnosis.json").exists()


class TestUnwritable:
    """Exit code 1: the work failed and says why."""

    def test_folder_below_a_file(
        self, gapscope: Command, sick: Path, tmp_path: Path
    ) -> None:
        (tmp_path / "file").touch()
        done = gapscope("diagnose", sick, "--out", tmp_path / "file" / "out")
        assert (
            done.code == 1
            and str(tmp_path / "file" / "out") in done.err
            and "--out" in done.err
        )

    def test_several_cases_below_a_file(
        self, gapscope: Command, sick: Path, healthy: Path, tmp_path: Path
    ) -> None:
        (tmp_path / "file").touch()
        done = gapscope("diagnose", sick, healthy, "--out", tmp_path / "file" / "out")
        assert done.code == 1 and str(tmp_path / "file" / "out") in done.err

    def test_prediction_below_a_file(
        self, gapscope: Command, sick: Path, tmp_path: Path
    ) -> None:
        (tmp_path / "file").touch()
        out = tmp_path / "file" / "tau.csv"
        done = gapscope(
            "predict", sick, "--recording", sick / "recording_0.csv", "--out", out
        )
        assert done.code == 1 and f"{out}: cannot be written" in done.err

    def test_prediction_on_a_folder(
        self, gapscope: Command, sick: Path, tmp_path: Path
    ) -> None:
        (tmp_path / "tau.csv").mkdir()
        done = gapscope(
            "predict",
            sick,
            "--recording",
            sick / "recording_0.csv",
            "--out",
            tmp_path / "tau.csv",
        )
        assert done.code == 1 and "cannot be written" in done.err
        assert files(tmp_path / "tau.csv") == []
        assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]

    def test_demo_below_a_file(self, gapscope: Command, tmp_path: Path) -> None:
        (tmp_path / "file").touch()
        assert (
            gapscope("demo", "--out", tmp_path / "file" / "demo", "--seed", 1).code == 1
        )

    def test_diagnosis_json_is_a_folder(
        self, gapscope: Command, sick: Path, tmp_path: Path
    ) -> None:
        (tmp_path / "out" / "diagnosis.json").mkdir(parents=True)
        done = gapscope("diagnose", sick, "--out", tmp_path / "out")
        assert done.code == 1 and "diagnosis.json" in done.err


BAD_MODELS = {
    "unknown effect": (
        "{effect: stiction, joints: [1], parameters: {torque: [1]}}",
        "unknown effect 'stiction'",
    ),
    "joint 3 of 2": (
        "{effect: coulomb_friction, joints: [3], parameters: {torque: [1]}}",
        "joint 3 of an arm with 2 joints",
    ),
    "out of bounds": (
        "{effect: actuator_delay, joints: [1], parameters: {delay: [5]}}",
        "outside",
    ),
}


class TestModel:
    @pytest.mark.parametrize(("entry", "message"), BAD_MODELS.values(), ids=BAD_MODELS)
    @pytest.mark.parametrize("command", ["gap", "predict"])
    def test_bad_model_is_bad_input(
        self,
        gapscope: Command,
        sick: Path,
        tmp_path: Path,
        command: str,
        entry: str,
        message: str,
    ) -> None:
        model = tmp_path / "model.yaml"
        model.write_text(f"schema: 1\neffects:\n  - {entry}\n")
        more = (
            ()
            if command == "gap"
            else (
                "--recording",
                sick / "recording_0.csv",
                "--out",
                tmp_path / "tau.csv",
            )
        )
        done = gapscope(command, sick, "--model", model, *more)
        assert done.code == 2 and message in done.err
        assert not (tmp_path / "tau.csv").exists()

    @pytest.mark.parametrize("command", ["gap", "predict"])
    def test_fault_names_the_model_file(
        self, gapscope: Command, sick: Path, tmp_path: Path, command: str
    ) -> None:
        model = tmp_path / "model.yaml"
        model.write_text(
            "schema: 1\neffects:\n  - {effect: stiction, joints: [1], parameters: {torque: [1]}}\n"
        )
        more = (
            ()
            if command == "gap"
            else (
                "--recording",
                sick / "recording_0.csv",
                "--out",
                tmp_path / "tau.csv",
            )
        )
        done = gapscope(command, sick, "--model", model, *more)
        assert f"{model}, effects[0]" in done.err

    def test_joint_that_does_not_exist_names_the_model_file(
        self, gapscope: Command, sick: Path, tmp_path: Path
    ) -> None:
        model = tmp_path / "model.yaml"
        model.write_text(
            "schema: 1\neffects:\n  - {effect: coulomb_friction, joints: [3], parameters: {torque: [1]}}\n"
        )
        assert str(model) in gapscope("gap", sick, "--model", model).err


class TestGap:
    def test_json(self, gapscope: Command, sick: Path, corrected: Path) -> None:
        done = gapscope("gap", sick, "--json")
        assert done.code == 0
        document = json.loads(done.out)
        assert document["case"] == "sick" and document["joints"] == ["yaw", "pitch"]
        assert [row["recording"] for row in document["recordings"]] == [
            f"recording_{k}.csv" for k in range(3)
        ]
        assert all(
            row["role"] == "fit" and len(row["torque_nrmse"]) == 2
            for row in document["recordings"]
        )
        after = json.loads(gapscope("gap", sick, "--json", "--model", corrected).out)
        for before_row, after_row in zip(
            document["recordings"], after["recordings"], strict=True
        ):
            assert (
                before_row["torque_nrmse"][1]
                > 0.1
                > 0.03
                > after_row["torque_nrmse"][1]
            )
            assert before_row["torque_nrmse"][0] == pytest.approx(
                after_row["torque_nrmse"][0]
            )

    def test_table(self, gapscope: Command, sick: Path) -> None:
        done = gapscope("gap", sick)
        assert done.code == 0 and "recording_2.csv" in done.out and "J2" in done.out

    def test_without_torque_the_work_fails(self, gapscope: Command, sick: Path) -> None:
        with (sick / "case.yaml").open("a") as file:
            file.write("import: {tau: null}\n")
        for arguments in (("gap", sick), ("diagnose", sick, "--out", sick / "out")):
            done = gapscope(*arguments)
            assert done.code == 1 and "sick: no recording carries a torque" in done.err


class TestPredict:
    def read(self, path: Path) -> tuple[list[str], np.ndarray]:
        with path.open(newline="") as file:
            header, *rows = csv.reader(file)
        return header, np.array(rows, dtype=float)

    def test_columns_and_rows(
        self, gapscope: Command, sick: Path, corrected: Path, tmp_path: Path
    ) -> None:
        out, source = tmp_path / "deep" / "tau.csv", sick / "recording_1.csv"
        done = gapscope(
            "predict", sick, "--recording", source, "--model", corrected, "--out", out
        )
        assert done.code == 0 and f"wrote {out}" in done.out
        header, rows = self.read(out)
        assert header == ["t", "tau1", "tau2"]
        case = load_case(sick)
        recording = load_recording(source, case.arm)
        assert rows.shape == (1501, 3) and np.isfinite(rows).all()
        np.testing.assert_array_equal(rows[:, 0], recording.t)
        arm = CorrectedArm(case.arm, read_corrected(corrected))
        np.testing.assert_array_equal(rows[:, 1:], predict_torque(arm, recording))
        assert files(tmp_path / "deep") == ["tau.csv"]

    def test_model_makes_a_difference(
        self, gapscope: Command, sick: Path, corrected: Path, tmp_path: Path
    ) -> None:
        source = sick / "recording_1.csv"
        gapscope("predict", sick, "--recording", source, "--out", tmp_path / "a.csv")
        gapscope(
            "predict",
            sick,
            "--recording",
            source,
            "--model",
            corrected,
            "--out",
            tmp_path / "b.csv",
        )
        (_, nominal), (_, found) = (
            self.read(tmp_path / name) for name in ("a.csv", "b.csv")
        )
        np.testing.assert_array_equal(nominal[:, 1], found[:, 1])
        assert np.abs(nominal[:, 2] - found[:, 2]).max() > 1.0

    def test_recording_with_t_and_q_alone(
        self, gapscope: Command, sick: Path, tmp_path: Path
    ) -> None:
        """The rows of the file, repeated ones included, and the recordings of the case are not needed."""
        header, rows = self.read(sick / "recording_1.csv")
        columns = [header.index(name) for name in ("t", "q1", "q2")]
        few = rows[:, columns]
        few = np.insert(few, 100, few[100], axis=0)
        np.savetxt(
            tmp_path / "few.csv",
            few,
            delimiter=",",
            header="t,q1,q2",
            comments="",
            fmt="%.17g",
        )
        for path in sick.glob("recording_*.csv"):
            path.unlink()
        done = gapscope(
            "predict",
            sick,
            "--recording",
            tmp_path / "few.csv",
            "--out",
            tmp_path / "tau.csv",
        )
        assert done.code == 0
        _, predicted = self.read(tmp_path / "tau.csv")
        assert predicted.shape == (1502, 3) and np.isfinite(predicted).all()
        np.testing.assert_array_equal(predicted[100], predicted[101])

    def test_recording_is_relative_to_the_current_folder(
        self,
        gapscope: Command,
        sick: Path,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        monkeypatch.chdir(tmp_path)
        done = gapscope(
            "predict", "sick", "--recording", "sick/recording_0.csv", "--out", "tau.csv"
        )
        assert done.code == 0 and (tmp_path / "tau.csv").is_file()

    def test_missing_recording(
        self, gapscope: Command, sick: Path, tmp_path: Path
    ) -> None:
        done = gapscope(
            "predict",
            sick,
            "--recording",
            tmp_path / "no.csv",
            "--out",
            tmp_path / "tau.csv",
        )
        assert done.code == 2 and str(tmp_path / "no.csv") in done.err

    def test_recording_without_positions(
        self, gapscope: Command, sick: Path, tmp_path: Path
    ) -> None:
        (tmp_path / "t.csv").write_text("t,q1\n0,0\n0.01,0\n0.02,0.1\n")
        done = gapscope(
            "predict",
            sick,
            "--recording",
            tmp_path / "t.csv",
            "--out",
            tmp_path / "tau.csv",
        )
        assert (
            done.code == 2 and "q2" in done.err and str(tmp_path / "t.csv") in done.err
        )


class TestBatch:
    def test_a_bad_case_does_not_stop_the_others(
        self, gapscope: Command, sick: Path, healthy: Path, tmp_path: Path
    ) -> None:
        replace(healthy / "recording_1.csv", "tau2", "torque2")
        out = tmp_path / "out"
        done = gapscope("diagnose", sick, healthy, "--out", out)
        assert done.code == 2
        assert files(out / "sick") == RESULTS
        assert not (out / "healthy" / "diagnosis.json").exists()
        summary = (out / "summary.html").read_text(encoding="utf-8")
        assert "sick" in summary and "healthy" in summary and "tau2" in summary
        assert f"wrote {out / 'summary.html'}" in done.out
        assert "healthy: " in done.out and "tau2" in done.out

    def test_all_good(self, both_results: Path) -> None:
        assert files(both_results) == sorted(
            [f"{case}/{name}" for case in ("sick", "healthy") for name in RESULTS]
            + ["summary.html", "units.json"]
        )
        verdicts = {
            c: json.loads((both_results / c / "diagnosis.json").read_text())["verdict"]
            for c in ("sick", "healthy")
        }
        assert verdicts == {"sick": "effects_found", "healthy": "no_gap"}

    def test_failed_case_leaves_no_diagnosis_of_an_earlier_run(
        self, gapscope: Command, sick: Path, healthy: Path, both_results: Path
    ) -> None:
        (healthy / "robot.urdf").unlink()
        done = gapscope("diagnose", sick, healthy, "--out", both_results)
        assert done.code == 2
        assert (both_results / "sick" / "diagnosis.json").exists()
        assert not (both_results / "healthy" / "diagnosis.json").exists()

    def test_same_name_twice(
        self, gapscope: Command, sick: Path, both_results: Path
    ) -> None:
        out, cases = both_results, (sick, sick / "case.yaml")
        assert gapscope("diagnose", *cases, "--out", out).code == 0
        assert (out / "sick" / "diagnosis.json").is_file()
        assert (out / "sick-2" / "diagnosis.json").is_file()

    def test_unknown_backend(
        self, gapscope: Command, sick: Path, healthy: Path, tmp_path: Path
    ) -> None:
        done = gapscope(
            "diagnose", sick, healthy, "--out", tmp_path / "out", "--backend", "cluster"
        )
        assert done.code == 2 and "--backend" in done.err and "cluster" in done.err


def test_an_empty_argument_is_not_the_folder_one_is_in(gapscope: Command) -> None:
    done = gapscope("diagnose", "case", "--out", "")
    assert done.code == 2
    assert "an argument is empty (after --out)" in done.err


def test_names_with_markup_are_printed_as_they_are(
    gapscope: Command, tmp_path: Path
) -> None:
    done = gapscope("gap", tmp_path / "[red]case[/red]")
    assert done.code == 2 and "[red]case[/red]" in done.err
