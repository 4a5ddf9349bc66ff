"""The demonstration from end to end: recorded in PyBullet, diagnosed from the files alone, opened."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gapscope.arm.case import load_case
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.effects.corrected_file import read_corrected
from gapscope.envs import mystery_arm


@pytest.mark.slow
def test_demo(
    gapscope: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With recordings that are shorter than those of a user's demonstration."""
    monkeypatch.setattr(mystery_arm, "DURATION", 4.0)
    out = tmp_path / "demo"
    done = gapscope("demo", "--out", out, "--seed", 3)
    assert done.code == 0
    document = json.loads(
        (out / "diagnosis" / "diagnosis.json").read_text(encoding="utf-8")
    )
    validate(document)
    truth = read_corrected(out / "truth.yaml")
    found = read_corrected(out / "diagnosis" / "corrected.yaml")
    assert 1 <= len(truth) <= 2 and document["verdict"] == "effects_found"
    assert {(e.name, e.joints) for e in truth} <= {(e.name, e.joints) for e in found}
    assert (
        "the truth, opened" in done.out
        and "recovery check" in done.out
        and "seed 3" in done.out
    )
    assert all(
        f"wrote {path}" in done.out
        for path in (out / "truth.yaml", out / "diagnosis" / "report.html")
    )
    case = load_case(out / "case")
    assert case.arm.n_joints == 7 and len(case.recordings) == 4
    assert "truth" not in (out / "case" / "case.yaml").read_text()
