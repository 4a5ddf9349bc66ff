"""Commands as instruments: loud encoders pull what least squares makes of the motion, not what the commands say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import synthetic
from synthetic import Truth

from gapscope.arm.case import Case
from gapscope.arm.control import PD
from gapscope.diagnosis.diagnose import diagnose, examine
from gapscope.diagnosis.document.diagnosis_json import validate

ROTOR = Truth(armature=(0.0, 0.0, 0.5))
CONTROLLER = PD(
    rate=500.0, kp=np.full(3, 100.0), kd=np.full(3, 10.0), feedforward="nominal"
)


def case(noise: float = 0.0, truth: Truth = ROTOR) -> Case:
    """A case whose encoders have white noise [rad], and whose references are what the arm did."""
    sound = synthetic.case(truth, seed=11, duration=8.0 if noise else 6.0)
    rng = np.random.default_rng(2)
    loud = tuple(
        replace(r, q=r.q + noise * rng.standard_normal(r.q.shape), q_ref=r.q)
        for r in sound.recordings
    )
    return replace(sound, recordings=loud, controller=CONTROLLER)


def findings(of: Case) -> dict[str, dict[str, Any]]:
    """What is found; encoders that are loud leave most of the gap: a rotor is possible, not named."""
    document = diagnose(of).document
    validate(document)
    return {e["effect"]: e for e in (*document["effects"], *document["possible"])}


def test_good_encoders_need_none() -> None:
    inertia = findings(case())["armature"]["parameters"]["inertia"]
    assert inertia["value"] == pytest.approx([0.5], rel=0.03)
    assert inertia["by_commands"] == pytest.approx(inertia["value"], rel=0.02)


def test_parameters_that_are_left_out_have_no_value_by_the_commands() -> None:
    found = findings(case(truth=Truth(scale=(0.0, 0.2, 0.0))))
    assert list(found) == ["torque_scale"]
    parameters = found["torque_scale"]["parameters"]
    assert set(parameters) == {"scale"}
    assert parameters["scale"]["by_commands"] == pytest.approx([0.2], rel=0.1)


@pytest.mark.nightly
def test_loud_encoders_pull_the_value_and_not_that_by_commands() -> None:
    entry = findings(case(1e-2))["armature"]
    inertia, place = entry["parameters"]["inertia"], entry["joints"].index(3)
    value, by_commands = (inertia[key][place] for key in ("value", "by_commands"))
    assert abs(by_commands - 0.5) < 0.5 * abs(value - 0.5)
    assert by_commands == pytest.approx(0.5, rel=0.1)


def test_it_takes_a_known_controller_and_every_reference() -> None:
    known = case()
    first, *others = known.recordings
    less = replace(known, recordings=(replace(first, q_ref=None), *others))
    for of in (replace(known, controller=None), less):
        found = examine(of)
        assert "armature" in found.findings and not found.by_commands
