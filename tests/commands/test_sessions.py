"""Whole sessions: the demonstration, a first log, and a log in degrees that a diagnosis mends."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gapscope.arm.case import load_case
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.setup_faults.detection import find_setup_faults
from gapscope.effects.corrected_file import read_corrected
from gapscope.envs import mystery_arm

Command = Callable[..., Any]
PAGE = Path(__file__).parents[2] / "docs" / "first_log.md"


@pytest.mark.slow
def test_demo(
    gapscope: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With recordings that are shorter than those of a user's demonstration."""
    monkeypatch.setattr(mystery_arm, "DURATION", 4.0)
    out = tmp_path / "demo"
    done = gapscope("demo", "--out", out, "--seed", 3)
    assert done.code == 0
    document = json.loads((out / "diagnosis" / "diagnosis.json").read_text("utf-8"))
    validate(document)
    truth = read_corrected(out / "truth.yaml")
    found = read_corrected(out / "diagnosis" / "corrected.yaml")
    assert 1 <= len(truth) <= 2 and document["verdict"] == "effects_found"
    assert {(e.name, e.joints) for e in truth} <= {(e.name, e.joints) for e in found}
    files = (f"wrote {out}/{x}" for x in ("truth.yaml", "diagnosis/report.html"))
    for words in ("the truth, opened", "recovery check", "seed 3", *files):
        assert words in done.out
    case = load_case(out / "case")
    assert case.arm.n_joints == 7 and len(case.recordings) == 4
    assert "truth" not in (out / "case" / "case.yaml").read_text()


@pytest.mark.slow
@pytest.mark.nightly
def test_commands_of_the_page_run_in_their_order(
    gapscope: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = PAGE.read_text(encoding="utf-8")
    every = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    # other blocks are lines of a case
    (effects,) = [block for block in every if block.startswith("# effects.yaml")]
    commands = re.findall(r"```sh\ngapscope (.*?)\n```", text)
    monkeypatch.chdir(tmp_path)
    Path("effects.yaml").write_text(effects, encoding="utf-8")

    said = {}
    for command in commands:
        done = gapscope(*shlex.split(command))
        assert done.code == 0, f"{command}: {done.err}"
        said[command.split()[0]] = " ".join((done.out + done.err).split())

    assert list(said) == ["record", "inspect", "check", "diagnose", "gap", "export"]
    assert "can be diagnosed" in said["check"]
    assert "Sign flip (joint 4)" in said["diagnose"]
    found = json.loads(Path("out/diagnosis.json").read_text(encoding="utf-8"))
    payload = next(e for e in found["effects"] if e["effect"] == "payload")
    assert payload["parameters"]["mass"]["value"] == pytest.approx(1.5, abs=0.02)
    assert Path("arm.xml").is_file()


def test_commands_go_on_with_the_case_that_a_diagnosis_mended(
    gapscope: Command, sick: Path, tmp_path: Path
) -> None:
    files = sorted(sick.glob("*.csv"))
    for file in files:
        table = pd.read_csv(file)
        table[["q1", "q2"]] = np.rad2deg(table[["q1", "q2"]])
        table.to_csv(file, index=False)
    predict = ("--recording", files[0], "--out", tmp_path / "prediction.csv")

    # a prediction for a motion in degrees is none; the gap is what it is
    refused = gapscope("predict", sick, *predict)
    assert refused.code == 2
    assert "degrees" in refused.err and "mended_case.yaml" in refused.err
    document = json.loads(gapscope("gap", sick, "--json").out)
    assert min(document["recordings"][0]["torque_nrmse"]) > 1.0
    assert any("check unit" in warning for warning in document["warnings"])

    out = tmp_path / "results"
    diagnosed = gapscope("diagnose", sick, "--out", out)
    mended = out / "mended_case.yaml"
    assert diagnosed.code == 0 and f"wrote {mended}" in diagnosed.err + diagnosed.out
    assert "unit mismatch (degrees) of joints 1 and 2" in mended.read_text()
    assert find_setup_faults(load_case(mended)) == ()

    # effects were found behind the fault: the model corrects the mended case
    assert gapscope("predict", mended, *predict).code == 0
    model = ("--model", out / "corrected.yaml")
    gaps = json.loads(gapscope("gap", mended, *model, "--json").out)
    assert max(max(row["torque_nrmse"]) for row in gaps["recordings"]) < 0.05
    assert gaps["warnings"] == []
