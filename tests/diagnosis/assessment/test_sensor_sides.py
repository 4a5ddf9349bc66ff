"""Recordings with joint torque sensors: on which side of them a gap lies, and findings that agree with it."""

from __future__ import annotations

import io
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sensed
import synthetic
from rich.console import Console
from synthetic import Truth, named

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.diagnosis.assessment.sensor_sides import link_torque
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.document.wording import sides_sentence
from gapscope.diagnosis.result import Diagnosis
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.reports.diagnosis import render, summary


def gaps(document: dict[str, Any], side: str) -> list[np.ndarray]:
    """Gaps of the joints on a side, before and after."""
    stages = (document["sides"][side][stage] for stage in ("before", "after"))
    return [np.array(stage["torque_nrmse"]) for stage in stages]


@cache
def rubbing() -> Diagnosis:
    """More Coulomb friction on joint 2."""
    return diagnose(sensed.case(Truth(coulomb=(0.0, 2.0, 0.0)), duration=6.0))


@pytest.mark.parametrize("name", sorted(set(CATALOGUE) - {"encoder_quantization"}))
def test_the_side_is_that_of_the_torque_behind_the_gear(name: str) -> None:
    """Effects of the link side, or of both, change the torque behind the gear; the others leave it as it is."""
    motion = synthetic.motion(3)
    t = np.arange(500) / 250.0
    moved = Motion(t, motion.position(t), motion.velocity(t), motion.acceleration(t))
    effect, per_joint = CATALOGUE[name], CATALOGUE[name].scope == "joint"
    given = {
        "com": [0.05] * 3,
        "force": [10.0] * 3,
        "link": 2.0,
        "start": 0.5,
        "end": 1.5,
    }
    values = {
        p.name: given.get(p.name, [p.typical[1]] * 3 if per_joint else p.typical[1])
        for p in effect.parameters
    }
    applied = AppliedEffect(name, (1, 2, 3) if per_joint else (), values)
    body = RigidBody(synthetic.arm())
    plain, changed = (
        link_torque(CorrectedArm(synthetic.arm(), e), body, moved)
        for e in ((), (applied,))
    )
    assert np.allclose(plain, changed) == (effect.side == "actuator")


def test_friction_lies_on_the_actuator_side() -> None:
    result = rubbing()
    document, sides = result.document, result.document["sides"]
    validate(document)
    assert named(result) == [("coulomb_friction", (2,))]
    assert sides["carried_by"] == ["neither", "actuator", "neither"]
    friction = {"effect": "coulomb_friction", "joints": [2], "side": "actuator"}
    assert sides["effects"] == [friction]
    before, after = gaps(document, "actuator")
    whole = document["gap"]["before"]["torque_nrmse"]
    assert before[1] == pytest.approx(whole[1], rel=0.05)
    assert after[1] < 0.2 * before[1]
    before, after = gaps(document, "link")
    assert before == pytest.approx(after, abs=2e-3)


def test_errors_of_the_sensors_are_not_taken_for_effects() -> None:
    """Zero and scale come out as they were put in."""
    sensor = rubbing().document["sides"]["sensor"]
    assert sensor["zero"]["value"] == pytest.approx(sensed.ZERO, abs=0.1)
    assert sensor["scale"]["value"] == pytest.approx(sensed.SCALE, abs=5e-3)
    assert np.abs(sensor["lag"]["value"]).max() < 1e-3


@cache
def carrying() -> Diagnosis:
    """A payload."""
    return diagnose(sensed.case(Truth(mass=1.0, com=(0.15, 0.0, 0.0)), duration=5.0))


def test_a_payload_lies_on_the_link_side() -> None:
    sides = carrying().document["sides"]
    assert named(carrying()) == [("payload", ())]
    assert sides["carried_by"][1:] == ["link", "link"]
    assert sides["effects"] == [{"effect": "payload", "joints": [], "side": "link"}]
    before, after = gaps(carrying().document, "link")
    assert (after[1:] < 0.3 * before[1:]).all()


def test_a_finding_on_the_wrong_side_closes_nothing_where_the_gap_lies() -> None:
    """A torque that looks like a spring, which the sensors do not see."""
    looks = Truth(extra=lambda t, q, dq: np.array([0.0, 4.0, 0.0]) * (q - 0.3))
    case = sensed.case(looks, on_link=Truth(), duration=10.0)
    both = diagnose(replace(case, recordings=case.recordings[:2]))
    assert named(both) == [("parallel_spring", (2,))]
    sides = both.document["sides"]
    assert [entry["side"] for entry in sides["effects"]] == ["link"]
    assert sides["carried_by"][1] in ("actuator", "both")
    before, after = gaps(both.document, "actuator")
    assert before[1] > 0.1 and after[1] == pytest.approx(before[1], rel=0.01)


def test_a_load_and_wrong_torque_constants_lie_on_both_sides() -> None:
    truth = Truth(mass=0.8, com=(0.15, 0.0, 0.0), scale=(0.0, 0.06, 0.06))
    case = sensed.case(truth, seed=3, duration=5.0)
    both = diagnose(replace(case, recordings=case.recordings[:2])).document
    assert both["sides"]["carried_by"] == ["link", "both", "both"]


@pytest.mark.nightly
def test_a_recording_without_sensors_counts_as_before() -> None:
    case = sensed.case(Truth(coulomb=(0.0, 2.0, 0.0)), duration=5.0)
    first, *others = case.recordings
    mixed = (first, *(replace(r, tau_sensor=None) for r in others))
    result = diagnose(replace(case, recordings=mixed))
    document = result.document
    validate(document)
    assert named(result) == [("coulomb_friction", (2,))]
    assert document["sides"]["recordings"] == [first.name]


def test_report_and_summary_tell_the_side(tmp_path: Path) -> None:
    render(rubbing(), tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    said = "The gap lies on the actuator side of joint 2."
    there = ('id="sides"', 'href="#sides"', "Actuator side", "Link side", said)
    assert [text for text in there if text not in page] == []
    stream = io.StringIO()
    Console(file=stream, width=80).print(summary(rubbing().document))
    assert f"By the torque sensors: {said}" in stream.getvalue()


def test_sides_in_words() -> None:
    told = {"sides": {"carried_by": ["link", "both", "actuator", "neither", "link"]}}
    assert sides_sentence(told) == (
        "The gap lies on the actuator side of joint 3, on the link side of joints 1 and 5 and on both sides of joint 2."
    )
    assert "neither side" in sides_sentence({"sides": {"carried_by": ["neither"]}})
