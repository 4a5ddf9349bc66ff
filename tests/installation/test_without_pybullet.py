"""Machines for which PyBullet has no wheel: MuJoCo takes its place, and the remedy is said."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from guard import HANG

from gapscope.arm.io.write_case import write_case
from gapscope.arm.robots import load_nominal_arm
from gapscope.envs.recorder import Plan, record_case

SCRIPT = """
import json, sys

sys.modules["pybullet"] = sys.modules["pybullet_data"] = None  # as if not installed
from gapscope.cli import main

for arguments in json.loads(sys.argv[1]):
    try:
        main(arguments)
    except SystemExit as ended:
        print(f"<{ended.code or 0}>", file=sys.stderr)
"""


@pytest.fixture
def case(tmp_path: Path) -> Path:
    """A short case of two joints of the iiwa, which comes with Gapscope."""
    joints = ("lbr_iiwa_joint_2", "lbr_iiwa_joint_4")
    locked = {f"lbr_iiwa_joint_{k}": 0.0 for k in (1, 3, 5, 6, 7)}
    arm = load_nominal_arm("kuka_iiwa", joints=joints, locked=locked)
    plan = Plan(recordings=2, duration=5.0, rate=100.0, engine="mujoco")
    recorded = record_case("short", arm, (), plan, np.random.default_rng(0))
    return write_case(recorded, tmp_path / "short").parent


def test_a_case_is_worked_on_with_mujoco_and_what_needs_pybullet_says_the_remedy(
    case: Path, tmp_path: Path
) -> None:
    effects = tmp_path / "effects.yaml"
    effects.write_text("schema: 1\neffects: []\n", encoding="utf-8")
    found, fitted = tmp_path / "found", tmp_path / "fitted"
    commands = (
        ("diagnose", case, "--out", found),
        ("identify", case, "--out", fitted),
        *(
            ("record", *asked, "--effects", effects, "--out", tmp_path / "case")
            for asked in (("kuka_iiwa", "--engine", "pybullet"), ("xarm6",))
        ),
    )
    process = [sys.executable, "-c", SCRIPT, json.dumps(commands, default=str)]
    done = subprocess.run(process, capture_output=True, text=True, timeout=HANG)
    # what each of the four says, and its exit code
    said = re.split(r"<(\d)>", done.stderr)
    assert said[1::2] == ["0", "0", "2", "2"], done.stderr
    assert "MuJoCo simulates the arm" in done.stderr + done.stdout
    document = json.loads((found / "diagnosis.json").read_text(encoding="utf-8"))
    assert document["gap"]["engine"] == "mujoco"
    assert document["gap"]["before"]["replay_rmse"] is not None
    assert (fitted / "identification.json").is_file()
    for folder in (found, fitted):
        assert (folder / "report.html").stat().st_size > 10_000
    for refused in (said[4], said[6]):
        assert "pip install 'gapscope[pybullet]'" in " ".join(refused.split())
