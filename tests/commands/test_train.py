"""The command train: what it writes, that it goes on, and messages that say what to change."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

Command = Callable[..., object]
QUICK = {
    "algorithm": "ppo",
    "steps": 128,
    "round_steps": 64,
    "environments": 1,
    "network": [8],
    "motion": "fourier",
    "motions": ["fourier"],
    "episode_length": 0.4,
    "duration": 0.4,
    "hyperparameters": {"n_steps": 64, "batch_size": 64},
}


@pytest.fixture
def settings(tmp_path: Path) -> Path:
    """A settings file for a training of a second."""
    path = tmp_path / "quick.yaml"
    path.write_text(yaml.safe_dump(QUICK))
    return path


def test_writes_agent_curve_and_page_and_goes_on(
    gapscope: Command, sick: Path, corrected: Path, settings: Path, tmp_path: Path
) -> None:
    out = tmp_path / "deep" / "out"
    command = ("train", corrected, "--robot", sick, "--effects", corrected)
    command += ("--agent", settings, "--out", out)
    done = gapscope(*command)
    assert done.code == 0, done.err
    names = ["policy.zip", "curve.csv", "learning_curve.html", "agent.json"]
    assert done.out.splitlines()[-4:] == [f"wrote {out / name}" for name in names]
    assert "on the hidden arm" in done.out and " is kept: " in done.out
    assert (out / "last" / "policy.zip").is_file()
    content = json.loads((out / "agent.json").read_text())
    assert content["joints"] == ["yaw", "pitch"] and content["steps"] == 128
    with (out / "curve.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["steps"] for row in rows] == ["0", "64", "128"]
    assert float(rows[0]["hidden_joint_error"]) > 0
    page = (out / "learning_curve.html").read_text(encoding="utf-8")
    assert "Plotly" in page and "<script src" not in page and "Training on" in page

    before = (out / "curve.csv").read_bytes()
    again = gapscope(*command)
    assert again.code == 0 and "done already" in again.err
    (out / "agent.json").unlink()
    assert gapscope(*command).code == 0
    assert (out / "curve.csv").read_bytes() == before
    other = gapscope(*command, "--seed", 1)
    assert other.code == 2 and "differs in settings" in other.err
    assert "--again" in other.err
    assert gapscope(*command, "--seed", 1, "--again").code == 0
    assert (out / "curve.csv").read_bytes() != before
