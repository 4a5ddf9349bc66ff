"""Machines for which PyBullet has no wheel: MuJoCo takes its place, and the remedy is said."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from guard import HANG

from gapscope.arm.io.write_case import write_case
from gapscope.arm.robots import load_nominal_arm
from gapscope.envs.recorder import Plan, record_case

SCRIPT = """
import sys

sys.modules["pybullet"] = sys.modules["pybullet_data"] = None  # as if not installed
from gapscope.cli import main

main(sys.argv[1:])
"""


def without_pybullet(*arguments: object) -> subprocess.CompletedProcess[str]:
    """A command in a process that cannot import PyBullet."""
    command = [sys.executable, "-c", SCRIPT, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=HANG)


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short case of two joints of the iiwa, which comes with Gapscope."""
    joints = ("lbr_iiwa_joint_2", "lbr_iiwa_joint_4")
    locked = {f"lbr_iiwa_joint_{k}": 0.0 for k in (1, 3, 5, 6, 7)}
    arm = load_nominal_arm("kuka_iiwa", joints=joints, locked=locked)
    plan = Plan(recordings=2, duration=5.0, rate=100.0, engine="mujoco")
    recorded = record_case("short", arm, (), plan, np.random.default_rng(0))
    return write_case(recorded, tmp_path_factory.mktemp("cases") / "short").parent


def test_diagnosis_and_report_are_made_with_mujoco(case: Path, tmp_path: Path) -> None:
    done = without_pybullet("diagnose", case, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "MuJoCo simulates the arm" in done.stderr + done.stdout
    document = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    assert document["gap"]["engine"] == "mujoco"
    assert document["gap"]["before"]["replay_rmse"] is not None
    assert (tmp_path / "report.html").stat().st_size > 10_000


def test_identification_and_report_are_made(case: Path, tmp_path: Path) -> None:
    done = without_pybullet("identify", case, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "identification.json").is_file()
    assert (tmp_path / "report.html").is_file()


@pytest.mark.parametrize("asked", [("kuka_iiwa", "--engine", "pybullet"), ("xarm6",)])
def test_what_needs_it_says_the_remedy(asked: tuple[str, ...], tmp_path: Path) -> None:
    effects = tmp_path / "effects.yaml"
    effects.write_text(yaml.safe_dump({"schema": 1, "effects": []}), encoding="utf-8")
    done = without_pybullet(
        "record", *asked, "--effects", effects, "--out", tmp_path / "case"
    )
    assert done.returncode == 2
    assert "pip install 'gapscope[pybullet]'" in done.stderr.replace("\n", " ")
