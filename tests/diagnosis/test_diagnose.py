"""A diagnosis as a whole: what it uses, what it must not use, and cases that are not what they say."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import synthetic
from synthetic import Truth, named

import gapscope
from gapscope.arm.case import Case
from gapscope.arm.errors import InputError
from gapscope.arm.io.json_file import plain
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.diagnosis import diagnose as of_sheet
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.document.wording import (
    nominal_friction_sentence,
    verdict_sentence,
)
from gapscope.diagnosis.result import Diagnosis

COULOMB = Truth(coulomb=(0.0, 2.0, 0.0))


def judged() -> Case:
    """A case with a recording that is set aside; its data sheet is where its friction is from."""
    case = synthetic.case(COULOMB, seed=7, judged=True)
    return replace(case, arm=replace(case.arm, friction_source="data sheet"))


TOLD: list[str] = []
"""The progress of that diagnosis."""


@cache
def found() -> Diagnosis:
    return diagnose(judged(), TOLD.append)


def changed(change: Callable[[Recording], Recording]) -> Diagnosis:
    """The diagnosis if what is set aside is changed."""
    case = judged()
    return diagnose(replace(case, judged=tuple(change(r) for r in case.judged)))


def values(result: Diagnosis) -> list[tuple[str, list[int], list[object]]]:
    """Name, joints and values of what is named or possible."""
    found = (*result.document["effects"], *result.document["possible"])
    return [
        (e["effect"], e["joints"], [p["value"] for p in e["parameters"].values()])
        for e in found
    ]


def left(result: Diagnosis) -> np.ndarray:
    """The gap of each joint after correction [1]."""
    return np.array(result.document["gap"]["after"]["torque_nrmse"])


def test_document_is_valid_json_of_plain_values_and_progress_is_told() -> None:
    document = found().document
    validate(document)
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert plain(document) == document
    assert len(TOLD) > 3 and any("coulomb_friction" in message for message in TOLD)


def test_case_is_described() -> None:
    document = found().document
    joints = ["joint_1", "joint_2", "joint_3"]
    assert document["arm"] == {"robot": "yaw_pitch_pitch", "joints": joints}
    fitted = [(f"recording_{k}.csv", "fit") for k in range(3)]
    roles = [(r["name"], r["role"]) for r in document["recordings"]]
    assert roles == [*fitted, ("judged.csv", "judge")]
    assert document["judged_on"] == "recordings set aside for judging"
    assert document["case"] == "synthetic" and document["schema"] == 1
    assert document["states"]["shared"] and document["states"]["differs"] == []
    assert "share a state" not in verdict_sentence(document)
    assert "sides" not in document and document["torque_from"] == "recorded"
    assert not any("must have commanded" in text for text in document["warnings"])
    values = {key: [2.0, 3.0, 1.0] for key in ("coulomb", "viscous")}
    assert document["nominal"]["friction"] == {"source": "data sheet", **values}
    said = nominal_friction_sentence(document)
    assert said.startswith(
        "Coulomb 1.00 to 3.00 N m and viscous 1.00 to 3.00 N m s/rad"
    )
    assert said.endswith("(from data sheet)")


def test_curves_fit_the_document() -> None:
    (trace,) = found().traces
    assert trace.recording == "judged.csv"
    assert trace.measured.shape == trace.nominal.shape == (len(trace.t), 3)
    assert trace.corrected.shape == trace.measured.shape
    assert {s.effect for s in found().signatures} == {"coulomb_friction"}
    assert found().spectrum.before.shape == (len(found().spectrum.frequency), 3)
    assert found().replayed.recording == "judged.csv"


FRICTION = '<dynamics damping="10.0" friction="0.5"/>'


@pytest.mark.parametrize(
    ("sheet", "source"),
    [
        ({}, "robot.urdf <dynamics>"),
        ({"coulomb": 1.0, "viscous": 1.0}, "data sheet"),
        (
            {"coulomb": 1.0},
            "coulomb from data sheet, viscous from robot.urdf <dynamics>",
        ),
        ({"coulomb": 0.0, "viscous": 0.0}, ""),
    ],
)
def test_source_of_the_friction_is_known(
    tmp_path: Path, sheet: dict[str, float], source: str
) -> None:
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(synthetic.URDF.replace("<limit", FRICTION + "<limit"))
    values = {name: [value] * 3 for name, value in sheet.items()}
    assert load_nominal_arm(urdf, sheet=values or None).friction_source == source


# Recordings that are set aside are judged on, and change no value.


@pytest.mark.nightly
@pytest.mark.parametrize("channel", ["tau", "q"])
def test_a_judged_recording_changes_no_value(channel: str) -> None:
    def spoilt(r: Recording) -> Recording:
        shaken = r.q + 0.01 * np.sin(2 * np.pi * 25 * r.t)[:, None]
        return replace(r, **{channel: shaken if channel == "q" else 1.3 * r.tau + 1.0})

    result = changed(spoilt)
    assert values(result) == values(found())
    assert channel == "q" or (left(result) > left(found()) + 0.02).all()


def test_gaps_are_those_of_the_judged_recording(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Only the judged arm has a further effect: the gap after it shows there, and is not explained.

    What an audit finds in the robot file is said first then.
    """
    monkeypatch.setattr(of_sheet, "odd_kinds", lambda urdf: "mass (2)")
    result = changed(lambda r: replace(r, tau=r.tau + np.array([3.0, 0.0, 0.0])))
    assert values(result) == values(found())
    assert left(result)[0] > 0.1
    assert result.document["verdict"] == "unexplained"
    first = result.document["warnings"][0]
    assert first.startswith("in the robot file: mass (2); see gapscope audit /")


def test_what_was_not_measured_of_a_judged_recording_has_no_weight() -> None:
    def clipped(r: Recording) -> Recording:
        assert r.tau is not None
        most = 0.6 * np.abs(r.tau[:, 1]).max()
        return replace(r, tau=np.clip(r.tau, [-np.inf, -most, -np.inf], most))

    result = changed(clipped)
    whole, part = (left(d)[1] for d in (found(), result))
    assert part < 2 * whole


def test_a_healthy_judged_recording_does_not_undo_what_was_fitted() -> None:
    healthy = synthetic.case(Truth(), seed=7, judged=True).judged
    result = diagnose(replace(judged(), judged=healthy))
    assert result.document["verdict"] != "no_gap"


def test_nothing_is_judged_on_a_recording_without_torque() -> None:
    result = changed(lambda r: replace(r, tau=None))
    assert result.document["judged_on"].startswith("each motion")
    # the liveliest
    assert result.replayed.recording == "recording_1.csv"


def test_of_one_recording_its_last_part_is_replayed() -> None:
    case = judged()
    whole = case.recordings[0]
    result = diagnose(replace(case, recordings=(whole,), judged=()))
    assert result.document["judged_on"].startswith("each motion")
    assert result.replayed.t[0] > 0.7 * whole.duration
    assert result.replayed.t[-1] == pytest.approx(whole.t[-1], abs=0.5)


# Cases of another robot.


@cache
def foreign() -> Case:
    """Recordings of the arm with the URDF of another."""
    case = synthetic.case(COULOMB, seed=7)
    urdf = case.arm.urdf.with_name("other.urdf")
    text = synthetic.URDF.replace('axis xyz="0 1 0"', 'axis xyz="1 0 0"')
    urdf.write_text(text.replace('mass value="5"', 'mass value="60"'))
    return replace(case, arm=NominalArm("other", urdf, case.arm.joints))


def test_another_robot_is_not_identified() -> None:
    with pytest.raises(InputError, match="probably another robot"):
        gapscope.identify(foreign())


@pytest.mark.nightly
def test_another_robot_is_said_and_nothing_is_found_of_it() -> None:
    result = diagnose(foreign())
    document = result.document
    validate(document)
    assert verdict_sentence(document).startswith("Probably another robot")
    assert document["verdict"] == "unexplained" and result.faults == ()
    assert not document["effects"] + document["possible"] + document["changes"]


def test_an_arm_that_its_data_sheet_makes_unlikely_is_no_other_robot() -> None:
    # eighteen times the deviation of what the joint has otherwise
    unlikely = Truth(coulomb=(0.0, 2.0, 0.0), offset=(0.0, 0.0, 40.0))
    result = synthetic.diagnosed(unlikely, seed=7)
    assert result.document["verdict"] == "effects_found"
    assert "misread" not in result.document
    assert named(result) == [("coulomb_friction", (2,)), ("torque_offset", (3,))]
