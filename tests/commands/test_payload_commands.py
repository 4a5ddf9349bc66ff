"""Commands on a case with a recording that carries a known payload."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from gapscope.arm.case import load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.io.write_case import write_recording
from gapscope.arm.known_load import KnownLoad

Command = Callable[..., object]
LOAD = KnownLoad(1.5, (0.25, 0.0, 0.05))
NAME = "recording_1.csv"


@pytest.fixture
def carried(healthy: Path) -> Path:
    """A healthy case whose second recording carries a load that the case does not declare."""
    case = load_case(healthy)
    body, recording = RigidBody(case.arm), case.recordings[1]
    dq = np.gradient(recording.q, recording.t, axis=0)
    motion = recording.q, dq, np.gradient(dq, recording.t, axis=0)
    more = body.carrying(LOAD).inverse_dynamics(*motion) - body.inverse_dynamics(
        *motion
    )
    assert recording.tau is not None
    write_recording(replace(recording, tau=recording.tau + more), healthy / NAME)
    return healthy


def declare(case: Path, **payloads: object) -> None:
    """Say in the case what was mounted."""
    content = yaml.safe_load((case / "case.yaml").read_text())
    (case / "case.yaml").write_text(
        yaml.safe_dump(content | {"payloads": payloads or {NAME: LOAD.entry()}})
    )


def gaps(gapscope: Command, case: Path) -> dict[str, np.ndarray]:
    """Largest torque NRMSE and replay gap of each recording, (2,)."""
    done = gapscope("gap", case, "--json")
    assert done.code == 0, done.err
    rows = json.loads(done.out)["recordings"]
    return {
        row["recording"]: np.array([max(row["torque_nrmse"]), max(row["replay_rmse"])])
        for row in rows
    }


def test_gap_carries_it(gapscope: Command, carried: Path) -> None:
    before = gaps(gapscope, carried)
    declare(carried)
    after = gaps(gapscope, carried)
    assert (after[NAME] < 0.2 * before[NAME]).all() and after[NAME][0] < 0.05
    assert all((after[name] == before[name]).all() for name in before if name != NAME)


def test_predict_carries_it(gapscope: Command, carried: Path, tmp_path: Path) -> None:
    declare(carried)
    case = load_case(carried)
    arguments = (
        "predict",
        carried,
        "--recording",
        carried / NAME,
        "--out",
        tmp_path / "tau.csv",
    )
    assert gapscope(*arguments).code == 0
    predicted = np.loadtxt(tmp_path / "tau.csv", delimiter=",", skiprows=1)[:, 1:]
    left = (case.recordings[1].tau - predicted)[100:-100]
    assert (left.std(axis=0) < 0.1 * case.recordings[1].tau.std(axis=0)).all()
    elsewhere = tmp_path / "copy.csv"
    elsewhere.write_bytes((carried / NAME).read_bytes())
    assert gapscope(*arguments[:3], elsewhere, *arguments[4:]).code == 0
    bare = np.loadtxt(tmp_path / "tau.csv", delimiter=",", skiprows=1)[:, 1:]
    assert np.abs(bare - predicted).max() > 1.0, (
        "a file that the case does not name carries nothing"
    )


def test_replay_carries_it(gapscope: Command, carried: Path, tmp_path: Path) -> None:
    recorded, found = load_recording(carried / NAME, load_case(carried).arm).q, []
    for declared in (False, True):
        if declared:
            declare(carried)
        out = tmp_path / f"{declared}.csv"
        assert (
            gapscope(
                "replay", carried, "--recording", carried / NAME, "--out", out
            ).code
            == 0
        )
        found.append(
            np.sqrt(
                (
                    (np.loadtxt(out, delimiter=",", skiprows=1)[:, 1:3] - recorded) ** 2
                ).mean()
            )
        )
    assert found[1] < 0.2 * found[0]


def test_diagnosis_and_its_report_say_what_was_mounted(
    gapscope: Command, carried: Path, tmp_path: Path
) -> None:
    declare(carried)
    assert gapscope("diagnose", carried, "--out", tmp_path / "out").code == 0
    document = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert (
        document["verdict"] == "no_gap"
        and document["recordings"][1]["payload"] == LOAD.entry()
    )
    assert (
        "recording_1.csv, with 1.5 kg" in (tmp_path / "out" / "report.html").read_text()
    )


def test_identified_case_keeps_it(
    gapscope: Command, carried: Path, tmp_path: Path
) -> None:
    declare(carried)
    out = tmp_path / "identified"
    assert gapscope("identify", carried, "--out", out).code == 0
    content = yaml.safe_load((out / "identified_case.yaml").read_text())
    assert list(content["payloads"]) == [content["recordings"][1]]
    assert gaps(gapscope, out / "identified_case.yaml")[NAME][0] < 0.05


def test_a_name_that_is_no_recording_is_refused(
    gapscope: Command, carried: Path, tmp_path: Path
) -> None:
    declare(carried, **{"recording_9.csv": LOAD.entry()})
    for arguments in (
        ("gap", carried),
        ("diagnose", carried, "--out", tmp_path / "out"),
        (
            "predict",
            carried,
            "--recording",
            carried / NAME,
            "--out",
            tmp_path / "tau.csv",
        ),
    ):
        done = gapscope(*arguments)
        assert (
            done.code == 2
            and "field payloads: no recording is called 'recording_9.csv'" in done.err
        )
        assert "did you mean recording_" in done.err
