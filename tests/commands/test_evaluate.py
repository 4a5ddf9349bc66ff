"""The command evaluate: what it writes, a file of the environment, and a run that was interrupted."""

from __future__ import annotations

import csv
import itertools
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sweeps import daily

from gapscope.agents.evaluation import EvaluationPlan, TrackingBench
from gapscope.agents.models import AgentModel, read_model
from gapscope.arm.case import load_case
from gapscope.commands.agent_files import FOLDER, Cells
from gapscope.envs.actions import Control
from gapscope.provenance import fingerprint

Command = Callable[..., Any]
QUICK = ("--motions", "fourier", "--duration", 0.6, "--disturbances", "none")
QUICK += ("--seeds", 1)
FILE = """
robot: kuka_iiwa
effects: {effects}
engine: [pybullet]
motion: fourier
disturbances: none
seeds: 1
episode_length: 0.6
bandwidth: 3
action: residual
"""
"""An environment, with a path that is relative to the file."""


@pytest.fixture
def evaluate(gapscope: Command, tmp_path: Path) -> Command:
    """Runs an evaluation: its outcome, and its document, if there is one."""

    def call(*arguments: object, out: str = "out") -> tuple[Any, Any]:
        done = gapscope("evaluate", *arguments, "--out", tmp_path / out)
        file = tmp_path / out / "evaluation.json"
        return done, json.loads(file.read_text()) if file.exists() else None

    return call


def test_writes_page_document_and_csv(
    evaluate: Command, sick: Path, corrected: Path, tmp_path: Path
) -> None:
    found = sick / "identification.json"
    files = {"files": {"case": "case.yaml", "effects": "effects.yaml"}}
    found.write_text(json.dumps(files), encoding="utf-8")
    shutil.copy(corrected, sick / "effects.yaml")
    named = ("pd", "nominal", f"mine={corrected}", f"fitted={found}")
    options = ("--robot", sick, "--effects", corrected, *QUICK)
    done, content = evaluate(*named, *options, out="deep/out")
    assert done.code == 0, done.err
    out = tmp_path / "deep" / "out"
    files = [f"evaluation.{ending}" for ending in ("html", "json", "csv")]
    assert done.out.splitlines()[-3:] == [f"wrote {out / name}" for name in files]
    assert sorted(path.name for path in out.iterdir()) == sorted(files)
    assert "mine" in done.out and "rank correlation" in done.out

    models = {line["model"]: line for line in content["models"]}
    assert list(models) == ["pd", "nominal", "mine", "fitted"]
    error = {name: line["joint_error"] for name, line in models.items()}
    assert error["mine"]["value"] < 0.3 * error["nominal"]["value"]
    assert error["fitted"] == error["mine"]
    assert models["pd"]["diverged"]["count"] == 0 and models["pd"]["margin"] > 4.0
    assert content["effects"][0]["effect"] == "viscous_friction"
    with (out / "evaluation.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 == len(content["episodes"])
    assert float(rows[0]["joint_error"]) > 0

    page = (out / "evaluation.html").read_text(encoding="utf-8")
    assert "<script src" not in page
    assert all(words in page for words in ("Plotly", "Tracking of", "mine"))


def test_a_file_stands_in_for_options_and_those_that_are_given_win(
    evaluate: Command, sick: Path, corrected: Path, tmp_path: Path
) -> None:
    env = tmp_path / "env.yaml"
    env.write_text(FILE.format(effects=corrected.name))
    given = ("--bandwidth", 4.0, "--robot", sick)
    done, content = evaluate("nominal", "--env", env, *given)
    assert done.code == 0 and "ignored in an evaluation: action" in done.err
    assert content["arm"]["joints"] == ["yaw", "pitch"]
    assert [e["effect"] for e in content["effects"]] == ["viscous_friction"]
    expected = {"motions": ["fourier"], "disturbances": ["none"], "seeds": [0]}
    expected |= {"duration": 0.6, "bandwidth": 4.0}
    assert {key: content["plan"][key] for key in expected} == expected
    options = (*given, "--effects", corrected, *QUICK)
    assert content == evaluate("nominal", *options, out="second")[1]


def test_the_registered_name_means_the_defaults(evaluate: Command) -> None:
    done, content = evaluate("pd", "--env", "gapscope/ArmTracking-v0", *QUICK)
    assert done.code == 0, done.err
    assert len(content["arm"]["joints"]) == 7
    plan = content["plan"]
    assert plan["bandwidth"] == 4.0 and plan["engines"] == ["pybullet"]


class UnpluggedError(Exception):
    """Somebody pulls the plug."""


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """How many cells were worked on; at ``limit`` the plug is pulled."""
    state = {"done": 0, "limit": 10**6}
    for name in ("episodes", "margin"):
        real = getattr(TrackingBench, name)

        def counting(bench: Any, *arguments: Any, real: Command = real) -> Any:
            if state["done"] >= state["limit"]:
                raise UnpluggedError
            state["done"] += 1
            return real(bench, *arguments)

        monkeypatch.setattr(TrackingBench, name, counting)
    return state


def unplugged(
    evaluate: Command, counted: dict[str, int], limit: int, *args: object
) -> None:
    """Run until the plug is pulled; nothing is counted yet of the run that goes on."""
    counted |= {"limit": limit, "done": 0}
    with pytest.raises(UnpluggedError):
        evaluate(*args)
    counted |= {"limit": 10**6, "done": 0}


def test_goes_on_where_it_was_also_with_other_models_and_seeds(
    evaluate: Command, sick: Path, tmp_path: Path, counted: dict[str, int]
) -> None:
    command = ("nominal", "pd", "--robot", sick, *QUICK)
    assert evaluate(*command, out="whole")[0].code == 0
    out = tmp_path / "out"
    unplugged(evaluate, counted, 4, "pd", "gravity", *command[2:], "--seeds", 2)
    assert len(list((out / FOLDER).iterdir())) == 4
    assert not (out / "evaluation.json").exists()
    done, _ = evaluate(*command)
    assert done.code == 0 and counted["done"] == 2
    assert "2 parts were taken" in done.said
    for name in ("evaluation.json", "evaluation.csv"):
        assert (out / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert not (out / FOLDER).exists()


def replaced(old: str, new: str) -> Command:
    return lambda path: path.write_text(path.read_text().replace(old, new))


CHANGES = {
    "effects": ("corrected.yaml", replaced("3.0", "2.5")),
    "model": ("model.yaml", replaced("3.0", "2.5")),
    "robot": ("sick/*.urdf", replaced('mass value="4"', 'mass value="4.1"')),
    "damaged": (f"out/{FOLDER}/*", lambda path: path.write_text(path.read_text()[:40])),
}


@pytest.mark.parametrize(
    "change",
    daily([*CHANGES, "--damping 0.8", "--again"], "robot", "damaged", "--again"),
)
def test_what_is_kept_is_not_used_for_anything_else(
    evaluate: Command,
    sick: Path,
    corrected: Path,
    tmp_path: Path,
    counted: dict[str, int],
    change: str,
) -> None:
    model = tmp_path / "model.yaml"
    model.write_text(corrected.read_text())
    command = (model, "--robot", sick, "--effects", corrected, *QUICK)
    unplugged(evaluate, counted, 1, *command)
    more = change.split() if change.startswith("--") else []
    pattern, spoil = CHANGES.get(change, ("", str))
    for path in tmp_path.glob(pattern) if pattern else ():
        spoil(path)
    done, _ = evaluate(*command, *more)
    assert done.code == 0 and counted["done"] == 2
    assert "were taken" not in done.said


def test_what_is_kept_of_an_agent_depends_on_the_model_that_it_acts_on(
    sick: Path, corrected: Path, tmp_path: Path
) -> None:
    """Whose file may change while that of the agent does not."""
    arm = load_case(sick, read_recordings=False).arm
    plan = EvaluationPlan(("fourier",), ("none",), seeds=(0,), duration=1.0)
    cells = Cells(tmp_path, TrackingBench(arm, (), plan))
    still = Control("residual", *np.ones((3, arm.n_joints)), None)
    models = [read_model(x, arm) for x in ("pd", "nominal", str(corrected), "pd")]
    agents = [AgentModel(np.zeros_like, x, still, (), 0.01, "same") for x in models]
    numbers = itertools.count()
    found = [cells(("a",), x, lambda: next(numbers)) for x in agents]
    assert found == [0, 1, 2, 0]


def test_fingerprint_tells_what_differs() -> None:
    values = [1, 1.0, "1", (1,), ((1,),), (1, 1), {"a": 1}, {"b": 1}, None, True]
    assert len({fingerprint(value) for value in values}) == len(values)
    assert fingerprint({"a": 1, "b": 2}) == fingerprint({"b": 2, "a": 1})
