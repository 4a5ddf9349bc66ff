"""A set of blind cases: made the same however it is made, sealed, run only where the labels are out of reach."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import pytest
import yaml

from gapscope.arm.errors import InputError
from gapscope.arm.io.json_file import to_json
from gapscope.blind_check import check as make_module
from gapscope.blind_check.check import (
    BlindPlan,
    frozen,
    make,
    open_labels,
    read_plan,
    run,
)
from gapscope.blind_check.scoring import score
from gapscope.cli import main
from gapscope.diagnosis import thresholds
from gapscope.provenance import source_files

PLAN = BlindPlan(
    1,
    0,
    0,
    1,
    1,
    0,
    effects=("torque_offset",),
    robots=("small",),
    duration=(4.0, 5.0),
    inertials_off=0.0,
)


def contents(folder: Path) -> dict[str, str]:
    """Hash of every file of the cases, the commitment aside: labels carry a salt."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(
            path.read_bytes()
        ).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "commitment.json"
    }


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A set of three small cases, and its labels at another place."""
    root = tmp_path_factory.mktemp("set")
    make(root / "cases", PLAN, seed=5, labels=root / "vault" / "labels")
    return root / "cases", root / "vault" / "labels"


@pytest.fixture
def copied(made: tuple[Path, Path], tmp_path: Path) -> tuple[Path, Path]:
    """A copy of that set that may be spoiled."""
    for source, name in zip(made, ("cases", "elsewhere/vault"), strict=True):
        shutil.copytree(source, tmp_path / name)
    return tmp_path / "cases", tmp_path / "elsewhere" / "vault"


@pytest.mark.nightly
def test_the_same_seed_gives_the_same_cases_whatever_the_number_of_jobs(
    made: tuple[Path, Path], tmp_path: Path
) -> None:
    make(tmp_path / "again", PLAN, seed=5, jobs=2)
    assert contents(tmp_path / "again") == contents(made[0])


def test_a_set_that_was_broken_off_is_finished_with_the_same_cases(
    made: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = []
    write = make_module.write_case

    def dies_at_the_second(*arguments: object) -> None:
        write(*arguments)  # type: ignore[arg-type]
        written.append(str(arguments[1]))
        if len(written) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(make_module, "write_case", dies_at_the_second)
    with pytest.raises(KeyboardInterrupt):
        make(tmp_path / "cases", PLAN, seed=5)
    assert not (tmp_path / "cases" / "commitment.json").exists()
    make(tmp_path / "cases", PLAN)
    assert (
        len(written) == 4
    )  # two before, the second of them lost, then that one and the third
    assert contents(tmp_path / "cases") == contents(made[0])


def test_another_plan_in_the_same_place_is_refused(made: tuple[Path, Path]) -> None:
    with pytest.raises(InputError, match="another plan or seed"):
        make(made[0], PLAN, seed=6, labels=made[1])


def test_labels_inside_the_cases_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="outside the cases"):
        make(tmp_path / "cases", PLAN, seed=5, labels=tmp_path / "cases" / "labels")


def test_the_cases_do_not_tell_the_truth(made: tuple[Path, Path]) -> None:
    files = [path for path in made[0].rglob("*") if path.is_file()]
    assert {path.suffix for path in files} == {".yaml", ".urdf", ".csv", ".json"}
    for path in files:
        text = path.read_text()
        assert (
            "torque_offset" not in text
            and "healthy" not in text
            and '"seed"' not in text
        )
    assert sorted(p.name for p in made[0].iterdir()) == [
        "case0000",
        "case0001",
        "case0002",
        "commitment.json",
    ]
    assert (made[1] / "labels.json").stat().st_mode & 0o077 == 0


@pytest.mark.parametrize("where", ["DIR-labels", "inside", "beside", "given"])
def test_the_run_refuses_where_the_labels_can_be_read(
    where: str,
    copied: tuple[Path, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    cases, vault = copied
    place = {
        "DIR-labels": tmp_path / "cases-labels",
        "inside": cases / "x",
        "beside": tmp_path / "x",
        "given": vault,
    }
    if where != "given":
        vault.rename(place[where])
    arguments = ["blind", "run", str(cases), "--out", str(tmp_path / "results")]
    arguments += ["--labels", str(vault)] if where == "given" else []
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2
    assert "would not be blind" in capsys.readouterr().err
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize("what", ["label", "recording"])
def test_a_truth_that_was_changed_is_refused(
    what: str, copied: tuple[Path, Path]
) -> None:
    cases, vault = copied
    file = (
        vault / "labels.json" if what == "label" else vault / "unseen" / "case0001.csv"
    )
    file.write_text(file.read_text().replace("1", "2", 1))
    with pytest.raises(
        InputError, match="hash was published" if what == "label" else "held out"
    ):
        open_labels(cases, vault)


@pytest.mark.slow
def test_a_set_is_run_resumed_and_scored(
    copied: tuple[Path, Path], tmp_path: Path
) -> None:
    cases, vault = copied
    results, said = tmp_path / "results", list[str]()
    (cases / "case0001" / "recording_a.csv").write_text("t,q1\n")
    assert run(cases, results, progress=said.append) == 1
    assert (
        len(said) == 3
        and json.loads((results / "case0001" / "run.json").read_text())["error"]
    )
    shutil.copy(
        vault / "unseen" / "case0001.csv", cases / "case0001" / "recording_a.csv"
    )
    again = []
    assert run(cases, results, progress=again.append) == 0
    assert len(again) == 1 and "case0001" in again[0]

    figures, _ = score(cases, results, vault, baselines=True)
    assert figures["cases"] == 3 and figures["failed"] == []
    assert (
        figures["frozen"]["complete"]
        and figures["frozen"]["changed_after_the_run"] == []
    )
    assert set(figures["baselines"]) == {
        "chance",
        "largest R^2",
        "forward BIC",
        "ridge",
    }

    file = results / "case0002" / "diagnosis.json"
    file.write_text(file.read_text().replace("0", "1", 1))
    assert score(cases, results, vault, baselines=False)[0]["frozen"][
        "changed_after_the_run"
    ] == ["case0002"]


def test_a_run_that_was_begun_with_another_source_is_not_continued(
    copied: tuple[Path, Path], tmp_path: Path
) -> None:
    cases, _ = copied
    hashed = json.loads((cases / "commitment.json").read_text())["labels_sha256"]
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "frozen.json").write_text(
        json.dumps({"labels_sha256": hashed, "source_sha256": "0"})
    )
    with pytest.raises(InputError, match="source changed"):
        run(cases, tmp_path / "results")


def test_frozen_covers_the_diagnosis_and_not_the_scorer() -> None:
    names = {path.name for path in source_files()}
    assert {"diagnose.py", "catalogue.py", "conditioning.py"} <= names
    assert not any("blind_check" in path.parts for path in source_files())


def test_frozen_holds_every_threshold_as_json() -> None:
    values = json.loads(to_json(frozen()))["thresholds"]
    assert values["OPEN_ALTERNATIVE"] == 0.05
    assert values["PACE_LAGS"] == [0.0, 0.1, 0.3]
    written = json.loads(json.dumps(values))
    assert written.keys() == {name for name in vars(thresholds) if name.isupper()}


def test_a_plan_is_read_from_yaml_and_its_faults_are_named(tmp_path: Path) -> None:
    file = tmp_path / "plan.yaml"
    file.write_text(yaml.safe_dump(PLAN.plain()))
    assert read_plan(file) == PLAN
    for change, problem in (
        ({"effects": ["payloat"]}, "payload"),
        ({"single": 3}, "unknown key 'single'"),
        ({"effects": "payload"}, "plan, effects: expected a list of names, got 'pay"),
        ({"effects": {"payload": 1}}, "plan, effects: expected a list of names"),
        ({"robots": 3}, "plan, robots: expected a list of names, got 3"),
        ({"robots": [3]}, "plan, robots: expected a list of names"),
        ({"duration": 8}, "plan, duration: expected a list of two times"),
        ({"duration": [8]}, "plan, duration: expected a list of two times"),
        ({"duration": ["a", "b"]}, "plan, duration: expected times of at least 3 s"),
        ({"duration": [9, 8]}, "plan, duration: .*longer than the longest"),
        ({"inertials_off": "a"}, "plan, inertials_off: expected a share"),
        ({"pairs": None}, "plan, pairs: expected a number of cases, got None"),
    ):
        file.write_text(yaml.safe_dump(change))
        with pytest.raises(InputError, match=problem) as caught:
            read_plan(file)
        assert caught.value.file == file


def test_a_plan_that_cannot_be_dealt_begins_nothing(tmp_path: Path) -> None:
    plan = BlindPlan(0, 1, 0, 0, 0, 0, effects=("payload",), robots=("small",))
    with pytest.raises(InputError, match="name more effects"):
        make(tmp_path / "cases", plan)
    assert not (tmp_path / "cases-labels").exists()


def test_results_are_looked_at_before_recordings_are_predicted(
    made: tuple[Path, Path], tmp_path: Path
) -> None:
    said: list[str] = []
    with pytest.raises(InputError, match="blind run first"):
        score(made[0], tmp_path, made[1], progress=said.append)
    assert said == ["compares the labels with the commitment"]
