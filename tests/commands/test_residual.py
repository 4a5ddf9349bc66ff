"""The command ``gapscope residual``: it learns, judges, attaches, and what it writes is used by other commands."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.case import Case, load_case
from gapscope.arm.io.write_case import write_case
from gapscope.arm.recording import Recording
from gapscope.diagnosis.gap.predict import predict_torque
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import read_corrected_arm
from gapscope.envs.replay import replay

pytest.importorskip("torch")
pytest.importorskip("sklearn")


def wave(recording: Recording) -> np.ndarray:
    """A torque that no effect explains: on joint 2, with position and direction."""
    torque = np.zeros_like(recording.q)
    speed = np.gradient(recording.q[:, 1], recording.t)
    torque[:, 1] = 4.0 * np.sin(3.0 * recording.q[:, 1]) * np.tanh(speed / 0.1)
    return torque


@pytest.fixture
def waved(sick: Path, tmp_path: Path) -> Path:
    """The case of ``sick`` with that torque in every recording."""
    case = load_case(sick)
    recordings = []
    for recording in case.recordings:
        assert recording.tau is not None
        tau = recording.tau + wave(recording)
        recordings.append(Recording(recording.name, recording.t, recording.q, tau))
    folder = tmp_path / "waved"
    write_case(Case("waved", folder, case.arm, tuple(recordings)), folder)
    return folder


def test_it_learns_and_what_it_writes_is_used(
    gapscope, waved: Path, corrected: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    options = ("--form", "additive", "--apart", "effects")
    done = gapscope("residual", waved, "--model", corrected, "--out", out, *options)
    assert done.code == 0, done.err
    assert "boosted" in done.out and str(out / "residual.json") in done.out
    content = json.loads((out / "residual.json").read_text())
    left = content["joints"][1]["rmse"]
    assert left["network"] < 0.5 * left["nothing"]
    assert [joint["name"] for joint in content["joints"]] == ["yaw", "pitch"]
    # joint 1 has nothing to learn: no harm is done there
    yaw = content["joints"][0]["rmse"]
    assert yaw["network"] < 1.02 * yaw["nothing"]
    assert content["physics"]["share_of_output"] < 1e-10
    assert content["physics"]["largest_move"] < 1e-6
    assert "Joint 2, pitch" in (out / "report.html").read_text()

    # the same effects, and predictions and replays with the network
    case = load_case(waved)
    model = read_corrected_arm(case.arm, out / "corrected.yaml")
    plain = CorrectedArm(case.arm, model.effects)
    assert [e.name for e in model.effects] == ["viscous_friction"]
    last = case.recordings[-1]
    assert last.tau is not None
    errors = [
        np.sqrt(np.mean((last.tau - predict_torque(arm, last))[100:-100, 1] ** 2))
        for arm in (plain, model)
    ]
    assert errors[1] < 0.5 * errors[0]
    gaps = [
        replay(case.arm, model.effects, last, None, residual=network).rmse[1]
        for network in (None, model.residual)
    ]
    assert gaps[1] < 0.7 * gaps[0]
    printed = gapscope("gap", waved, "--model", out / "corrected.yaml", "--json")
    with_network = json.loads(printed.out)["recordings"][-1]["replay_rmse"][1]
    np.testing.assert_allclose(with_network, gaps[1], rtol=1e-9)
