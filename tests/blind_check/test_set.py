"""A set of blind cases: made the same however it is made, sealed, run only where the labels are out of reach."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml

from gapscope.arm.errors import InputError
from gapscope.arm.io.json_file import to_json, write_json
from gapscope.blind_check import check as make_module
from gapscope.blind_check.check import (
    COMMITMENT,
    DONE,
    FROZEN,
    LABELS,
    BlindPlan,
    frozen,
    make,
    open_labels,
    read_commitment,
    read_plan,
    run,
)
from gapscope.blind_check.scoring import METHODS, score
from gapscope.cli import main
from gapscope.diagnosis import thresholds
from gapscope.provenance import source_files

SMALL = {"robots": ("small",), "duration": (4.0, 5.0), "inertials_off": 0.0}
PLAN = BlindPlan(1, 0, 0, 1, 1, 0, effects=("torque_offset",), **SMALL)


def contents(folder: Path) -> dict[Path, bytes]:
    """Every file of the cases, the commitment aside: labels carry a salt."""
    files = {path for path in folder.rglob("*") if path.is_file()}
    kept = files - {folder / COMMITMENT}
    return {path.relative_to(folder): path.read_bytes() for path in kept}


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
    assert not (tmp_path / "cases" / COMMITMENT).exists()
    make(tmp_path / "cases", PLAN)
    # two before, the second of them lost, then that one and the third
    assert len(written) == 4
    assert contents(tmp_path / "cases") == contents(made[0])


def test_another_plan_in_the_same_place_and_labels_inside_the_cases_are_refused(
    made: tuple[Path, Path], tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="another plan or seed"):
        make(made[0], PLAN, seed=6, labels=made[1])
    with pytest.raises(InputError, match="outside the cases"):
        make(tmp_path / "cases", PLAN, seed=5, labels=tmp_path / "cases" / "labels")


def test_the_cases_do_not_tell_the_truth(made: tuple[Path, Path]) -> None:
    files = [path for path in made[0].rglob("*") if path.is_file()]
    assert {path.suffix for path in files} == {".yaml", ".urdf", ".csv", ".json"}
    for text in (path.read_text() for path in files):
        assert not any(x in text for x in ("torque_offset", "healthy", '"seed"'))
    cases = ["case0000", "case0001", "case0002"]
    assert sorted(path.name for path in made[0].iterdir()) == [*cases, COMMITMENT]
    assert (made[1] / LABELS).stat().st_mode & 0o077 == 0


@pytest.mark.parametrize("where", ["DIR-labels", "inside", "beside", "given"])
def test_the_run_refuses_where_the_labels_can_be_read(
    where: str, copied: tuple[Path, Path], tmp_path: Path, capsys: Any
) -> None:
    cases, vault = copied
    places = {
        "DIR-labels": tmp_path / "cases-labels",
        "inside": cases / "x",
        "beside": tmp_path / "x",
    }
    arguments = ["blind", "run", str(cases), "--out", str(tmp_path / "results")]
    if where == "given":
        arguments += ["--labels", str(vault)]
    else:
        vault.rename(places[where])
    with pytest.raises(SystemExit):
        main(arguments)
    assert "would not be blind" in capsys.readouterr().err
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(
    ("what", "problem"),
    [(LABELS, "hash was published"), ("unseen/case0001.csv", "held out")],
)
def test_a_truth_that_was_changed_is_refused(
    what: str, problem: str, copied: tuple[Path, Path]
) -> None:
    cases, vault = copied
    file = vault / what
    file.write_text(file.read_text().replace("1", "2", 1))
    with pytest.raises(InputError, match=problem):
        open_labels(cases, vault)


@pytest.mark.slow
def test_a_set_is_run_resumed_and_scored(
    copied: tuple[Path, Path], tmp_path: Path
) -> None:
    cases, vault = copied
    results, said = tmp_path / "results", list[str]()
    spoiled = cases / "case0001" / "recording_a.csv"
    spoiled.write_text("t,q1\n")
    assert run(cases, results, progress=said.append) == 1
    assert len(said) == 3
    assert json.loads((results / "case0001" / DONE).read_text())["error"]
    shutil.copy(vault / "unseen" / "case0001.csv", spoiled)
    again: list[str] = []
    assert run(cases, results, progress=again.append) == 0
    assert len(again) == 1 and "case0001" in again[0]

    figures, _ = score(cases, results, vault, baselines=True)
    assert figures["cases"] == 3 and figures["failed"] == []
    frozen_run = figures["frozen"]
    assert frozen_run["complete"] and frozen_run["changed_after_the_run"] == []
    assert figures["baselines"].keys() == {"chance", *METHODS}

    file = results / "case0002" / "diagnosis.json"
    file.write_text(file.read_text().replace("0", "1", 1))
    figures, _ = score(cases, results, vault, baselines=False)
    assert figures["frozen"]["changed_after_the_run"] == ["case0002"]


def test_a_run_that_was_begun_with_another_source_is_not_continued(
    copied: tuple[Path, Path], tmp_path: Path
) -> None:
    cases, _ = copied
    begun = read_commitment(cases) | {"source_sha256": "0"}
    write_json(begun, tmp_path / "results" / FROZEN)
    with pytest.raises(InputError, match="source changed"):
        run(cases, tmp_path / "results")


def test_frozen_covers_the_diagnosis_with_its_thresholds_and_not_the_scorer() -> None:
    names = {path.name for path in source_files()}
    assert {"diagnose.py", "catalogue.py", "conditioning.py"} <= names
    assert not any("blind_check" in path.parts for path in source_files())
    values = json.loads(to_json(frozen()))["thresholds"]
    assert values["OPEN_ALTERNATIVE"] == 0.05
    assert values["PACE_LAGS"] == [0.0, 0.1, 0.3]
    assert values.keys() == {name for name in vars(thresholds) if name.isupper()}


def test_a_plan_is_read_from_yaml_and_its_faults_are_named(tmp_path: Path) -> None:
    file = tmp_path / "plan.yaml"
    file.write_text(yaml.safe_dump(PLAN.plain()))
    assert read_plan(file) == PLAN
    for change, problem in (
        ({"effects": ["payloat"]}, "payload"),
        ({"single": 3}, "unknown key 'single'"),
        ({"effects": "payload"}, "plan, effects: expected a list of names, got 'pay"),
        ({"robots": [3]}, "plan, robots: expected a list of names"),
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
