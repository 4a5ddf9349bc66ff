"""``gapscope fleet`` from cases to tables and page: what is done again, what is kept, what a failure leaves."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import fsspec
import pandas as pd
import pytest
from filelock import FileLock

import gapscope
from gapscope.arm.errors import GapscopeError, InputError, InterruptedRunError
from gapscope.many.fleet import FleetPlan, run_fleet
from gapscope.many.rows import FleetStore


@pytest.mark.slow
def test_from_cases_to_page_and_again(
    command: Callable[..., Any], fleet_folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    done = command("fleet", fleet_folder, "--out", out)
    assert done.code == 1 and "arm_A" in done.out
    assert "2 diagnosed, 1 failed, 0 kept" in done.out
    store = FleetStore(out)
    cases = store.cases().set_index("unit")
    assert list(cases["date"]) == ["2026-03-14"] * 3
    assert cases.loc["arm_A", "verdict"] == "effects_found"
    assert cases.loc["arm_B", "verdict"] == "no_gap"
    assert "field robot: names ../../robot.urdf" in cases.loc["arm_C", "error"]
    assert not list(Path(out / "cases").rglob(".*.parquet"))

    # the numbers are those of the diagnosis that was kept
    kept = out / cases.loc["arm_A", "kept"]
    document = json.loads((kept / "diagnosis.json").read_text("utf-8"))
    (effect,) = document["effects"]
    plain = pd.read_parquet(out / "effects", filters=[("named", "==", True)])
    (row,) = plain.to_dict("records")
    parameter = effect["parameters"]["coefficient"]
    place = row["effect"], row["joint"], row["si_unit"]
    assert place == ("viscous_friction", 1, "N m s/rad")
    assert [row["value"], row["std"]] == [*parameter["value"], *parameter["std"]]
    assert row["low"] < row["value"] < row["high"]
    overview = json.loads((out / "fleet.json").read_text("utf-8"))
    assert [unit["unit"] for unit in overview["worst"]] == ["arm_A", "arm_B"]
    page = (out / "fleet.html").read_text("utf-8")
    assert f'href="{cases.loc["arm_A", "kept"]}/diagnosis.json"' in page
    assert "../../robot.urdf" in page

    # a touched case is fetched and found unchanged; a changed one replaces its row; what failed is tried again
    (fleet_folder / "arm_A_2026-03-14" / "case.yaml").touch()
    again = gapscope.fleet(fleet_folder, out)
    assert str(again.counts).startswith("0 diagnosed, 1 failed, 2 kept")
    assert again.to_frame()["result"].nunique() == 3
    broken, healthy = (fleet_folder / f"arm_{name}_2026-03-14" for name in "CB")
    shutil.rmtree(broken)
    shutil.copytree(healthy, broken)
    assert command("fleet", fleet_folder, "--out", out).code == 0
    cases = FleetStore(out).cases()
    assert len(cases) == 3 and (cases["error"] == "").all()
    # merged: one file of each table for a robot and date
    assert len(list((out / "cases/robot=one").rglob("*.parquet"))) == 1


def test_what_is_kept_is_linked_and_goes_with_its_row(
    fleet_folder: Path, tmp_path: Path
) -> None:
    case, out = fleet_folder / "arm_B_2026-03-14", tmp_path / "out"
    gapscope.fleet(case, out)
    # kept without its report, which nothing links
    gapscope.fleet(case, out, keep="report")
    page = (out / "fleet.html").read_text("utf-8")
    assert "/diagnosis.json" in page and "/report.html" not in page
    gapscope.fleet(case, out, keep="report", again=True)
    assert "/report.html" in (out / "fleet.html").read_text("utf-8")
    (kept,) = FleetStore(out).cases()["kept"]
    assert [x.parent for x in out.rglob("diagnosis.json")] == [out / kept]


def test_cases_in_memory_are_diagnosed_by_this_process_alone(
    fleet_folder: Path, tmp_path: Path
) -> None:
    memory = fsspec.filesystem("memory")
    memory.put(str(fleet_folder / "arm_B_2026-03-14"), "/b_2026-05", recursive=True)
    try:
        with pytest.raises(InputError, match="other processes do not see"):
            run_fleet(FleetPlan(("memory://",), tmp_path, jobs=2), print)
        counts = run_fleet(FleetPlan(("memory://",), tmp_path, keep="nothing"), print)
        assert counts.diagnosed == 1
        (row,) = FleetStore(tmp_path).cases().to_dict("records")
        assert row["case"] == "memory://b_2026-05" and row["kept"] == ""
        assert not (tmp_path / "diagnoses").exists()
    finally:
        memory.store.clear()


def test_one_run_at_a_time(fleet_folder: Path, tmp_path: Path) -> None:
    with (
        FileLock(tmp_path / ".lock"),
        pytest.raises(GapscopeError, match="another run writes"),
    ):
        run_fleet(FleetPlan((str(fleet_folder),), tmp_path), print)


def test_what_was_reported_is_kept_by_a_run_that_is_interrupted_or_killed(
    fleet_folder: Path, tmp_path: Path
) -> None:
    broken, out = fleet_folder / "arm_C_2026-03-14", tmp_path / "out"
    killed = tmp_path / "killed"

    def interrupt(message: str) -> None:
        if message.startswith("0 diagnosed, 1 failed"):
            # what a run that is killed here leaves behind
            shutil.copytree(out, killed)
            raise KeyboardInterrupt

    with pytest.raises(InterruptedRunError, match="1 failed"):
        run_fleet(FleetPlan((str(broken), str(fleet_folder)), out), interrupt)
    for folder in (out, killed):
        assert list(FleetStore(folder).cases()["case"]) == [str(broken)]


def test_nothing_is_left_in_scratch(
    fleet_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A case that fails while it is there, and what a killed worker would have left."""
    scratch = tmp_path / "scratch"
    broken = str(fleet_folder / "arm_C_2026-03-14")
    plan = FleetPlan((broken,), tmp_path / "out", scratch=scratch)
    made: list[str] = []

    def fetched(*arguments: object) -> None:
        made.extend(path.name for path in scratch.iterdir())
        raise GapscopeError("ended there", "")

    def see(message: str) -> None:
        # removed before the result is there
        assert not list(scratch.glob("*"))

    with monkeypatch.context() as patch:
        patch.setattr("gapscope.many.fleet.fetch", fetched)
        run_fleet(plan, see)
    (name,) = made
    (scratch / name).mkdir()
    (scratch / "gapscope-fleet-other-k").mkdir()
    # the next run with these results, whatever its cases, removes what a killed one has left
    run_fleet(replace(plan, cases=()), lambda message: None)
    assert [path.name for path in scratch.iterdir()] == ["gapscope-fleet-other-k"]
