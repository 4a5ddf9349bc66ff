"""Commands on a case with a recording that carries a known payload."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from gapscope.arm.case import load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.write_case import write_recording
from gapscope.arm.known_load import KnownLoad

Command = Callable[..., Any]
LOAD = KnownLoad(1.5, (0.25, 0.0, 0.05))
NAME = "recording_1.csv"


@pytest.fixture
def carried(healthy: Path) -> Path:
    """A healthy case whose second recording carries a load that the case does not declare."""
    case = load_case(healthy)
    body, recording = RigidBody(case.arm), case.recordings[1]
    dq = np.gradient(recording.q, recording.t, axis=0)
    motion = recording.q, dq, np.gradient(dq, recording.t, axis=0)
    needed = [b.inverse_dynamics(*motion) for b in (body.carrying(LOAD), body)]
    torque = recording.tau + needed[0] - needed[1]
    write_recording(replace(recording, tau=torque), healthy / NAME)
    return healthy


def declare(case: Path, name: str) -> None:
    """Say in the case what was mounted."""
    with (case / "case.yaml").open("a") as file:
        file.write("\n" + yaml.safe_dump({"payloads": {name: LOAD.entry()}}))


def gaps(gapscope: Command, case: Path) -> dict[str, np.ndarray]:
    """Largest torque NRMSE and replay gap of each recording, (2,)."""
    done = gapscope("gap", case, "--json")
    assert done.code == 0, done.err
    rows = json.loads(done.out)["recordings"]
    keys = ("torque_nrmse", "replay_rmse")
    return {r["recording"]: np.array([max(r[key]) for key in keys]) for r in rows}


def test_gap_prediction_and_identified_case_carry_it(
    gapscope: Command, carried: Path, tmp_path: Path
) -> None:
    """A file that the case does not name carries nothing."""
    before = gaps(gapscope, carried)
    declare(carried, NAME)
    after = gaps(gapscope, carried)
    assert (after[NAME] < 0.2 * before[NAME]).all() and after[NAME][0] < 0.05
    assert all((after[name] == before[name]).all() for name in before if name != NAME)

    recorded = load_case(carried).recordings[1].tau
    elsewhere, out = tmp_path / "copy.csv", tmp_path / "out.csv"
    elsewhere.write_bytes((carried / NAME).read_bytes())
    predicted = []
    for path in (carried / NAME, elsewhere):
        more = ("--recording", path, "--out", out)
        assert gapscope("predict", carried, *more).code == 0
        predicted.append(np.loadtxt(out, delimiter=",", skiprows=1)[:, 1:])
    left = (recorded - predicted[0])[100:-100]
    assert (left.std(axis=0) < 0.1 * recorded.std(axis=0)).all()
    assert np.abs(predicted[1] - predicted[0]).max() > 1.0

    found = tmp_path / "identified"
    assert gapscope("identify", carried, "--out", found).code == 0
    content = yaml.safe_load((found / "identified_case.yaml").read_text())
    assert list(content["payloads"]) == [content["recordings"][1]]
    assert gaps(gapscope, found / "identified_case.yaml")[NAME][0] < 0.05


def test_diagnosis_and_its_report_say_what_was_mounted(
    gapscope: Command, carried: Path, tmp_path: Path
) -> None:
    declare(carried, NAME)
    out = tmp_path / "out"
    assert gapscope("diagnose", carried, "--out", out).code == 0
    document = json.loads((out / "diagnosis.json").read_text())
    assert document["verdict"] == "no_gap"
    assert document["recordings"][1]["payload"] == LOAD.entry()
    assert "recording_1.csv, with 1.5 kg" in (out / "report.html").read_text()
