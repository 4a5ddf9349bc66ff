"""The command matter: effects ranked by what they do to a reference or under a policy; what cannot be asked."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from cases import valid_document

Command = Callable[..., Any]
EFFECTS = """schema: 1
case: sick
effects:
  - {effect: viscous_friction, joints: [2], parameters: {coefficient: [3.0]}}
  - {effect: coulomb_friction, joints: [1], parameters: {torque: [0.01]}}
"""


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A file of two effects, one of which hardly does anything."""
    file = tmp_path / "corrected.yaml"
    file.write_text(EFFECTS, encoding="utf-8")
    return file


def test_a_reference_under_a_controller(
    gapscope: Command, sick: Path, model: Path, tmp_path: Path
) -> None:
    out, task = tmp_path / "out", sick / "recording_0.csv"
    done = gapscope("matter", sick, "--task", task, "--model", model, "--out", out)
    assert done.code == 0, done.err
    content = valid_document(out / "matter.json")
    first, last = content["rows"]
    assert (first["effect"], last["effect"]) == ("viscous_friction", "coulomb_friction")
    assert first["matters"]["value"] > 5 * last["matters"]["value"]
    # alone it is nearly all that all make, and without it nearly nothing is left
    alone, without = (first[key]["error"]["value"] for key in ("alone", "without"))
    assert alone == pytest.approx(content["all"]["error"]["value"], rel=0.05)
    assert without == pytest.approx(content["nominal"]["error"]["value"], rel=0.05)
    assert content["summary"] in " ".join(done.out.split())
    assert "Plotly.newPlot" in (out / "matter.html").read_text(encoding="utf-8")


def test_a_trajectory_as_excite_writes_it_is_a_plan(
    gapscope: Command, sick: Path, model: Path, tmp_path: Path
) -> None:
    task = tmp_path / "plan.csv"
    planned = ("--evaluations", 5, "--no-collisions", "--singular", 0)
    planned += ("--optimiser", "random", "--duration", 4, "--frequency", 0.25)
    made = gapscope("excite", sick / "robot.urdf", *planned, "--out", task)
    assert made.code == 0, made.err
    done = gapscope("matter", sick, "--task", task, "--model", model, "--json")
    assert done.code == 0, done.err
    content = json.loads(done.out)
    assert content["task"] == "plan.csv"
    assert content["rows"][0]["effect"] == "viscous_friction"


def test_values_are_drawn_within_the_intervals_of_a_diagnosis(
    gapscope: Command, sick: Path, results: Path, tmp_path: Path
) -> None:
    out, task = tmp_path / "out", sick / "recording_0.csv"
    options = ("--task", task, "--diagnosis", results, "--seeds", 3)
    done = gapscope("matter", sick, *options, "--out", out)
    assert done.code == 0, done.err
    (row,) = valid_document(out / "matter.json")["rows"]
    ends = row["range"]["coefficient"]
    assert ends["low"][0] < 3.0 < ends["high"][0]
    assert row["matters"]["low"] < row["matters"]["value"] < row["matters"]["high"]


def test_a_policy_as_onnx(
    gapscope: Command, sick: Path, model: Path, tmp_path: Path
) -> None:
    onnx = pytest.importorskip("onnx")
    make, single = onnx.helper, onnx.TensorProto.FLOAT
    # zeros of as many numbers as there are joints
    size = make.make_tensor("size", onnx.TensorProto.INT64, [2], [1, 2])
    graph = make.make_graph(
        [make.make_node("ConstantOfShape", ["size"], ["action"])],
        "policy",
        [make.make_tensor_value_info("observation", single, ["batch", "width"])],
        [make.make_tensor_value_info("action", single, [1, 2])],
        [size],
    )
    file = tmp_path / "policy.onnx"
    opset = make.make_opsetid("", 17)
    onnx.save(make.make_model(graph, opset_imports=[opset], ir_version=9), str(file))
    options = ("--task", file, "--model", model, "--seeds", 1)
    done = gapscope("matter", sick, *options, "--json")
    assert done.code == 0, done.err
    first = json.loads(done.out)["rows"][0]
    assert first["effect"] == "viscous_friction"
    assert 0 < first["alone"]["reward"]["value"] < 1.1
    assert first["alone"]["success"]["value"] == 1.0
    file.write_bytes(b"nothing")
    done = gapscope("matter", sick, *options)
    assert done.code == 2 and "is no ONNX model" in done.err
