"""The watch as a user runs it: a log in parts, a restart between them, events in a file."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import yaml
from sweeps import nightly
from typer.testing import CliRunner

from gapscope.arm.errors import InputError
from gapscope.arm.io.json_file import schema
from gapscope.arm.recording import Recording
from gapscope.cli import app
from gapscope.effects.corrected import CorrectedArm
from gapscope.watching.detector import STATE, WatchSettings
from gapscope.watching.watch import Watch

Write = Callable[[Recording, Path], Path]


@pytest.fixture
def case(at_work: Any, tmp_path: Path) -> Path:
    """A case of the arm, without recordings that are there."""
    arm = at_work.arm
    sheet = {key: getattr(arm, key).tolist() for key in ("coulomb", "viscous")}
    sheet["armature"] = arm.armature.tolist()
    content = {"name": "watched", "robot": str(arm.urdf), "nominal": sheet}
    content["recordings"] = ["log.csv"]
    file = tmp_path / "case.yaml"
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    return file


def run(*arguments: Any) -> str:
    result = CliRunner().invoke(app, ["watch", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    return result.output


def slipping(at_work: Any) -> Recording:
    """The encoder of joint 2 slips by 0.05 rad."""
    recording = at_work.recording(50.0)
    q = recording.q.copy()
    q[recording.t >= 36.0, 1] += 0.05
    return replace(recording, q=q)


def loaded(at_work: Any) -> Recording:
    return replace(at_work, change=36.0).recording(50.0, load=2.0)


@pytest.mark.parametrize(
    ("changing", "words"),
    [(slipping, "its reading jumped by"), nightly(loaded, "a load was picked up")],
)
def test_restarted_watch_says_the_same_as_one_that_ran_through(
    changing: Callable[[Any], Recording],
    words: str,
    at_work: Any,
    write_csv: Write,
    case: Path,
    tmp_path: Path,
) -> None:
    recording = changing(at_work)
    whole = write_csv(recording, tmp_path / "log.csv").read_bytes().split(b"\n")
    growing, out = tmp_path / "part" / "log.csv", tmp_path / "out"
    growing.parent.mkdir()
    options = (case, "--learn", 20, "--once", "--out", out)
    said = []
    for stop in (3401, 4402, len(whole)):
        growing.write_bytes(b"\n".join(whole[:stop]) + b"\n")
        said.append(run(growing, "--case", *options))
    assert "learnt 20 s" in said[0]
    assert words in said[1] + said[2]
    lines = (out / "events.jsonl").read_text(encoding="utf-8").splitlines()
    stored = [json.loads(line) for line in lines]
    assert [entry["number"] for entry in stored] == [1, 2]
    settings = WatchSettings(tmp_path / "log.csv", learning=20.0, until_idle=0.0)
    through = Watch(CorrectedArm(at_work.arm), settings)
    once = [json.loads(e.as_line(k)) for k, e in enumerate(through.run(), start=1)]
    assert stored == once
    for entry in stored:
        jsonschema.validate(entry, schema("event"))


def folder_of(write_csv: Write, tmp_path: Path, *recordings: Recording) -> Path:
    """A folder with a log of each."""
    logs = tmp_path / "logs"
    logs.mkdir()
    for name, recording in zip("ab", recordings, strict=True):
        write_csv(recording, logs / f"{name}.csv")
    return logs


def test_once_reads_a_folder_that_was_just_copied_and_counts_what_it_read(
    at_work: Any, write_csv: Write, case: Path, tmp_path: Path
) -> None:
    both = at_work.recording(24.0), at_work.recording(8.0, start=40.0)
    logs = folder_of(write_csv, tmp_path, *both)
    options = (case, "--learn", 20, "--once", "--rest", 1, "--out", tmp_path / "out")
    assert "2 recordings read" in run(logs, "--case", *options)
    # nothing new is no failure of a later run
    assert "0 recordings read" in run(logs, "--case", *options)


def test_once_says_what_changed_in_a_log_of_a_few_seconds(
    at_work: Any, write_csv: Write, case: Path, tmp_path: Path
) -> None:
    loaded = replace(at_work, change=0.0).recording(10.0, start=40.0, load=2.0)
    logs = folder_of(write_csv, tmp_path, at_work.recording(26.0), loaded)
    said = run(logs, "--case", case, "--learn", 20, "--once", "--rest", 1)
    found = re.search(r"a load was picked up at .* of b.csv: mass \+([\d.]+)", said)
    assert found and float(found[1]) == pytest.approx(2.0, abs=0.2), said


def test_once_reads_a_log_to_its_end(
    at_work: Any, write_csv: Write, case: Path, tmp_path: Path
) -> None:
    """A log that was just written, of fewer lines than show a rate at a glance."""
    log = write_csv(at_work.recording(0.3), tmp_path / "log.csv")
    said = run(log, "--case", case, "--once", "--rest", 1)
    assert "1 recordings read" in said


@pytest.mark.parametrize(
    ("name", "numbers", "option"),
    [
        ("learning", (float("nan"), float("inf"), 5.0), "--learn"),
        ("false_alarms", (float("nan"), 0.0), "--false-alarms"),
        ("rest", (-5.0,), "--rest"),
        ("until_idle", (float("nan"),), "--until-idle"),
    ],
)
def test_a_number_that_makes_no_sense_names_its_option(
    name: str, numbers: tuple[float, ...], option: str
) -> None:
    for number in numbers:
        with pytest.raises(InputError, match=f"{option}: expected"):
            WatchSettings(Path("log.csv"), **{name: number})


def test_once_fails_where_there_is_nothing_to_read(case: Path, tmp_path: Path) -> None:
    empty = tmp_path / "logs"
    empty.mkdir()
    arguments = ["watch", str(empty), "--case", str(case), "--once"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 1
    assert "no recording was read" in result.output + str(result.exception)


def test_state_of_another_arm_is_not_gone_on_with(
    at_work: Any, write_csv: Write, tmp_path: Path
) -> None:
    log = write_csv(at_work.recording(24.0), tmp_path / "log.csv")
    settings = WatchSettings(log, tmp_path / "out", learning=20.0, until_idle=0.0)
    arm = CorrectedArm(at_work.arm)
    list(Watch(arm, settings).run())
    assert Watch(arm, settings).resumed
    other = replace(at_work.arm, coulomb=2 * at_work.arm.coulomb)
    assert not Watch(replace(arm, arm=other), settings).resumed
    lacking = np.ones((at_work.arm.n_joints, 10))
    assert not Watch(replace(arm, remainder=lacking), settings).resumed


def test_another_source_is_read_from_its_start(
    at_work: Any, write_csv: Write, tmp_path: Path
) -> None:
    logs = folder_of(write_csv, tmp_path, *2 * [at_work.recording(6.0)])
    read = []
    for source in (logs, logs / "a.csv", logs / "b.csv", logs):
        settings = WatchSettings(source, tmp_path / "out", until_idle=0.0, rest=0.0)
        watch = Watch(CorrectedArm(at_work.arm), settings)
        list(watch.run())
        read.append(watch.read)
    assert read == [{"a.csv", "b.csv"}, {"a.csv"}, {"b.csv"}, {"a.csv", "b.csv"}]


def test_a_request_to_stop_at_a_damaged_row_loses_no_recording(
    at_work: Any, write_csv: Write, tmp_path: Path
) -> None:
    log = write_csv(at_work.recording(6.0), tmp_path / "log.csv")
    lines = log.read_text(encoding="utf-8").splitlines(keepends=True)
    lines[99] = lines[99].replace(",", ",nan,", 1)
    log.write_text("".join(lines), encoding="utf-8")
    settings = WatchSettings(log, tmp_path / "out", until_idle=0.0, rest=0.0)
    watch = Watch(CorrectedArm(at_work.arm), settings)
    said: list[str] = []
    for event in watch.run(lambda: bool(said)):
        said.append(event.sentence)
    assert "line 100" in said[0]
    assert watch.read == {"log.csv"}


def test_a_damaged_state_is_an_error_that_says_what_to_do(
    at_work: Any, write_csv: Write, tmp_path: Path
) -> None:
    log = write_csv(at_work.recording(4.0), tmp_path / "log.csv")
    out = tmp_path / "out"
    out.mkdir()
    (out / STATE).write_bytes(b"no state")
    with pytest.raises(InputError, match="delete it"):
        Watch(CorrectedArm(at_work.arm), WatchSettings(log, out))


def test_a_source_of_which_nothing_can_be_used_is_an_error(
    at_work: Any, tmp_path: Path
) -> None:
    log = tmp_path / "log.csv"
    log.write_text("time,a\n" + "1,2\n" * 60, encoding="utf-8")
    watch = Watch(CorrectedArm(at_work.arm), WatchSettings(log, until_idle=0.0))
    with pytest.raises(InputError, match="log.csv"):
        list(watch.run())


def test_a_request_to_stop_ends_between_two_parts(
    at_work: Any, write_csv: Write, tmp_path: Path
) -> None:
    log = write_csv(at_work.recording(24.0), tmp_path / "log.csv")
    watch = Watch(CorrectedArm(at_work.arm), WatchSettings(log, tmp_path / "out"))
    assert list(watch.run(lambda: True)) == []
    assert (tmp_path / "out" / STATE).is_file()


def test_robot_and_case_exclude_each_other(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["watch", str(tmp_path)])
    assert isinstance(result.exception, InputError)
