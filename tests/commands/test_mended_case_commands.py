"""A log in degrees from the first command to the last: refused, measured, diagnosed, mended."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gapscope.arm.case import load_case
from gapscope.diagnosis.setup_faults.detection import find_setup_faults


def test_commands_go_on_with_the_case_that_a_diagnosis_mended(
    gapscope: Callable[..., Any], sick: Path, tmp_path: Path
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
    measured = gapscope("gap", sick, "--json")
    assert measured.code == 0
    document = json.loads(measured.out)
    assert min(document["recordings"][0]["torque_nrmse"]) > 1.0
    assert any("check unit" in warning for warning in document["warnings"])

    out = tmp_path / "results"
    diagnosed = gapscope("diagnose", sick, "--out", out)
    mended = out / "mended_case.yaml"
    assert diagnosed.code == 0 and f"wrote {mended}" in diagnosed.err + diagnosed.out
    assert "unit_mismatch (degrees), joint 1, 2" in mended.read_text()
    assert find_setup_faults(load_case(mended)) == ()

    # effects were found behind the fault: the model corrects the mended case
    assert gapscope("predict", mended, *predict).code == 0
    model = ("--model", out / "corrected.yaml")
    gaps = json.loads(gapscope("gap", mended, *model, "--json").out)
    assert max(max(row["torque_nrmse"]) for row in gaps["recordings"]) < 0.05
    assert gaps["warnings"] == []
