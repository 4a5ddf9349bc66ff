"""Cases from a simulator that shares no code with the project, against their labels, which the diagnosis never sees."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gapscope.arm.case import load_case
from gapscope.arm.io.load_recording import load_recording
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.gap.predict import predict_torque
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import TRIM, low_pass, torque_scale

pytestmark = pytest.mark.shared_data


def label_of(sample_cases: Path, name: str) -> dict[str, Any]:
    labels = json.loads((sample_cases / "labels.json").read_text(encoding="utf-8"))
    return next(label for label in labels if label["case"] == name)


def nrmse(sample_cases: Path, name: str, corrected: CorrectedArm) -> np.ndarray:
    """Torque NRMSE on recording_d, by the definition, of the torque that ``predict`` gives."""
    recording = load_recording(sample_cases / name / "recording_d.csv", corrected.arm)
    edge = round(TRIM * recording.rate)
    measured, predicted = (
        low_pass(x, recording.rate, 12.0)[edge:-edge]
        for x in (recording.tau, predict_torque(corrected, recording))
    )
    return np.sqrt(((measured - predicted) ** 2).mean(axis=0)) / torque_scale(measured)


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["case001", "case005"])
def test_effect_and_joints_are_those_of_the_label(
    sample_cases: Path, name: str
) -> None:
    label, case = label_of(sample_cases, name), load_case(sample_cases / name)
    result = diagnose(load_case(sample_cases / name))
    validate(result.document)
    assert result.document["verdict"] == "effects_found"
    true = [(e["effect"], e["joints"]) for e in label["effects"]]
    assert [(e.name, list(e.joints)) for e in result.effects] == true
    # nothing is unexplained, so that nothing has to be placed
    assert "unexplained" not in (result.document["next_recording"] or "")
    for found, effect in zip(result.effects, label["effects"], strict=True):
        for key, parameter in effect["parameters"].items():
            values = found.parameters[key], parameter["value"]
            np.testing.assert_allclose(*values, rtol=0.25)
    before, after = (
        nrmse(sample_cases, name, CorrectedArm(case.arm, effects))
        for effects in ((), result.effects)
    )
    np.testing.assert_allclose(before, label["gap"], rtol=0.1, atol=0.003)
    closed = (before - after).sum() / (before - label["floor"]).sum()
    assert closed >= 0.9, f"{closed:.3f} of the gap is closed"


def test_healthy_case(sample_cases: Path) -> None:
    """Its floor is within a factor of two and a half of that of the label."""
    label, case = label_of(sample_cases, "case006"), load_case(sample_cases / "case006")
    result = diagnose(load_case(sample_cases / "case006"))
    assert label["effects"] == [] and result.effects == ()
    assert result.document["verdict"] == "no_gap"
    left = nrmse(sample_cases, "case006", CorrectedArm(case.arm))
    assert (left < 1.2 * np.array(label["gap"])).all()
    ratio = np.array(result.document["gap"]["before"]["floor"]) / label["floor"]
    assert (ratio > 0.4).all() and (ratio < 2.5).all(), ratio


@pytest.mark.nightly
def test_effect_outside_the_catalogue(sample_cases: Path) -> None:
    (effect,) = label_of(sample_cases, "case008")["effects"]
    assert effect["effect"] == "unknown"
    document = diagnose(load_case(sample_cases / "case008")).document
    left = document["unexplained"]
    assert document["verdict"] == "unexplained" and left["above_floor"]
    assert {region["joint"] for region in left["where"]} == set(effect["joints"])
    assert "joint 1" in document["next_recording"]
