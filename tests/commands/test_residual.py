"""The command ``gapscope residual``: it learns, judges, attaches, and what it writes is used by other commands."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cases import each

from gapscope.arm.case import load_case
from gapscope.arm.io.write_case import write_case
from gapscope.arm.recording import Recording
from gapscope.diagnosis.gap.predict import predict_torque
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
    case, folder = load_case(sick), tmp_path / "waved"
    made = each(case, lambda r: replace(r, tau=r.tau + wave(r)))
    write_case(replace(made, name="waved", folder=folder), folder)
    return folder


def test_it_learns_and_what_it_writes_is_used(
    gapscope, waved: Path, corrected: Path, tmp_path: Path
) -> None:
    out, bristles = tmp_path / "out", tmp_path / "bristles.yaml"
    bristles.write_text(f"{corrected.read_text()}presliding: [0.001, 0.002]\n")
    options = ("--form", "additive", "--apart", "effects")
    done = gapscope("residual", waved, "--model", bristles, "--out", out, *options)
    assert done.code == 0, done.err
    assert "boosted" in done.out and str(out / "residual.json") in done.out
    content = json.loads((out / "residual.json").read_text())
    assert [joint["name"] for joint in content["joints"]] == ["yaw", "pitch"]
    yaw, pitch = (joint["rmse"] for joint in content["joints"])
    assert pitch["network"] < 0.5 * pitch["nothing"]
    # joint 1 has nothing to learn: no harm is done there
    assert yaw["network"] < 1.02 * yaw["nothing"]
    assert content["physics"]["share_of_output"] < 1e-10
    assert content["physics"]["largest_move"] < 1e-6
    assert "Joint 2, pitch" in (out / "report.html").read_text()

    # the same effects and presliding, and predictions and replays with the network
    case = load_case(waved)
    model = read_corrected_arm(case.arm, out / "corrected.yaml")
    assert [e.name for e in model.effects] == ["viscous_friction"]
    assert model.arm.presliding.tolist() == [0.001, 0.002]
    last, errors, gaps = case.recordings[-1], [], []
    for network in (None, model.residual):
        arm = replace(model, residual=network)
        left = (last.tau - predict_torque(arm, last))[100:-100, 1]
        errors.append(np.sqrt(np.mean(left**2)))
        found = replay(case.arm, model.effects, last, None, residual=network)
        gaps.append(found.rmse[1])
    assert errors[1] < 0.5 * errors[0] and gaps[1] < 0.7 * gaps[0]
    printed = gapscope("gap", waved, "--model", out / "corrected.yaml", "--json")
    with_network = json.loads(printed.out)["recordings"][-1]["replay_rmse"][1]
    np.testing.assert_allclose(with_network, gaps[1], rtol=1e-9)
