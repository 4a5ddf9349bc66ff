"""What the check says of a good case, of one fault each, and of cases that cannot be diagnosed."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

import gapscope
from gapscope.arm.io.json_file import check_document
from gapscope.case_check.check import check_case
from gapscope.diagnosis.gap import plausible_data

Make = Callable[..., Path]


def warned(check: dict[str, Any]) -> str:
    """All that is not as it should be, in one text."""
    return "\n".join(
        "{level} {topic} {place}: {said} -> {remedy}".format(**x)
        for x in check["remarks"]
        if x["level"] != "ok"
    )


def in_degrees(table: dict[str, np.ndarray]) -> None:
    for name in ("q1", "q2", "dq1", "dq2", "q_ref1", "q_ref2"):
        table[name] = np.rad2deg(table[name])


def test_nothing_is_wrong_with_a_good_case(make_case: Make, tmp_path: Path) -> None:
    result = gapscope.check(make_case())
    assert set(result.to_frame()["level"]) == {"ok"}
    assert "two can be diagnosed" in result.summary()
    (path,) = result.save(tmp_path / "out")
    check = json.loads(path.read_text())
    assert check["can_be_diagnosed"] is True
    topics = {remark["topic"] for remark in check["remarks"]}
    assert {"torque", "excitation", "controller", "data sheet", "model"} <= topics
    assert check["excited"] == 1.0
    sizes = {(e["effect"], *e["joints"]): e["half"] for e in check["expected"]}
    assert 0 < sizes["viscous_friction", 1] < 10


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"nominal": None}, "no rotor inertia is stated; no friction is stated"),
        ({"controller": None}, "no controller"),
        ({"recordings": ["recording_0.csv"]}, "parts of the one recording"),
        ({"recordings": ["recording_0.csv", "recording_0.csv"]}, "hold the same"),
        ({"import": {"tau": ["tau2", "tau1"]}}, "Joint swap (torque)"),
        ({"import": {"tau": {"column": "tau{j}", "scale": 40}}}, "Torque unit (current)"),
        ({"import": {"q": ["q1", "q1"]}}, "q1 and q2 are the same column"),
        ({"import": {"dq": {"column": "dq{j}", "scale": -3}}}, "-3 times it"),
        ({"import": {"q_ref": {"column": "q_ref{j}", "scale": 5}}}, "far from q_ref"),
    ],
)  # fmt: skip
def test_one_fault_of_the_case_file_is_a_warning(
    make_case: Make, change: dict[str, object], said: str
) -> None:
    check = check_case(make_case(**change))
    assert all(words in warned(check) for words in said.split("; "))
    assert check["can_be_diagnosed"], warned(check)


def test_a_torque_computed_with_other_gains_is_said(make_case: Make) -> None:
    """Its recordings are put right before it is asked what they could show."""

    def computed(table: dict[str, np.ndarray]) -> None:
        for j, (kp, kd) in enumerate(((800.0, 60.0), (300.0, 22.0)), 1):
            # what the declared controller would have commanded: T de/dt + e = tau / kp, T = kd / kp
            kept = np.exp(-0.004 * kp / kd)
            target = table[f"tau{j}"] / kp
            error = lfilter([1 - kept], [1, -kept], target)
            rate = (target - error) * kp / kd
            table[f"q_ref{j}"] = table[f"q{j}"] + error
            table[f"dq_ref{j}"] = table[f"dq{j}"] + rate
            table[f"tau{j}"] = 80.0 * error + 2.5 * rate

    controller = {"rate": 250, "kp": [800, 300], "kd": [60, 22]}
    check = check_case(make_case(spoil=computed, controller=controller))
    assert "Unmeasured torque" in warned(check) and check["expected"]


def test_what_could_show_is_asked_of_the_windows_of_a_long_log(
    make_case: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = make_case()

    def half() -> float:
        expected = check_case(folder)["expected"]
        return next(e["half"] for e in expected if e["effect"] == "viscous_friction")

    whole = half()
    for name in ("LONG_RECORDINGS", "EXAMINED"):
        monkeypatch.setattr(plausible_data, name, 8.0)
    assert half() > whole


def rubbing(table: dict[str, np.ndarray]) -> None:
    """Dry friction of which no data sheet says anything."""
    for joint, friction in ((1, 40.0), (2, 20.0)):
        speed = np.gradient(table[f"q{joint}"], table["t"])
        table[f"tau{joint}"] += friction * np.tanh(speed / 0.005)


@pytest.mark.parametrize(
    ("beside", "within"), [({}, 0.3), ({"nominal": None, "spoil": rubbing}, 1.5)]
)
def test_a_base_that_is_mounted_turned_is_said_with_its_gravity(
    make_case: Make, beside: dict[str, Any], within: float
) -> None:
    text = warned(check_case(make_case(gravity=[9.81, 0.0, 0.0], **beside)))
    assert "mounted turned" in text and "another robot" not in text
    (shown,) = re.findall(r"-> say in the case gravity: \[(.*)\]", text)
    assert np.allclose([float(x) for x in shown.split(",")], [0, 0, -9.81], atol=within)


def test_the_torque_of_another_robot_is_said_and_not_vouched_for(
    make_case: Make,
) -> None:
    def foreign(table: dict[str, np.ndarray]) -> None:
        for j in (1, 2):
            table[f"tau{j}"] = 30 * np.cos((4 + j) * table["t"] ** 1.1)

    result = gapscope.check(make_case(spoil=foreign))
    assert "another robot" in str(result.document["remarks"])
    assert "first see to what is said of its torque" in result.summary()


def test_an_arm_that_stands_still_cannot_be_diagnosed(make_case: Make) -> None:
    def still(t: np.ndarray) -> np.ndarray:
        noise = np.random.default_rng(0).standard_normal((len(t), 2))
        return np.array([0.4, -0.7]) + 1e-5 * noise

    def as_held(table: dict[str, np.ndarray]) -> None:
        for j in (1, 2):
            table[f"tau{j}"] = np.full_like(table["t"], 3.0) + 0.1 * np.sin(table["t"])

    check = check_case(make_case((still,), spoil=as_held))
    assert "the arm stands still" in warned(check) and not check["can_be_diagnosed"]


@pytest.mark.parametrize(
    ("motion", "said"),
    [
        (lambda t: np.column_stack([np.sin(2 * t), 0 * t + 0.3]), "joint 2: at rest"),
        (lambda t: np.column_stack([np.sin(2 * t), np.abs((0.4 * t) % 2 - 1)]), "joint 2: hardly more than one speed"),
        (lambda t: np.column_stack([np.sin(2 * t), 0.02 * t**2 - 1]), "joint 2: one direction only"),
        (lambda t: np.column_stack([np.sin(2 * t), np.sin(0.4 * t)]), "joint 2: fewer than 4 reversals"),
        (lambda t: 0.05 * np.column_stack([np.sin(2 * t), np.sin(3 * t)]), "hardly any change of gravity"),
    ],
)  # fmt: skip
def test_what_a_motion_cannot_tell_is_said(make_case: Make, motion, said: str) -> None:
    assert said in warned(check_case(make_case((motion,))))


def clipped(tau: np.ndarray) -> np.ndarray:
    return np.clip(tau, -90, 20.0)


def strong(tau: np.ndarray) -> np.ndarray:
    return tau * 150 / np.abs(tau).max()


@pytest.mark.parametrize(
    ("change", "sheet", "said"),
    [
        (clipped, {"torque_limit": [20, 40]}, "at the torque limit"),
        (strong, {}, "beyond the torque limit of the robot file"),
    ],
)
def test_torques_at_a_limit_or_beyond_are_said(
    make_case: Make, change: Callable, sheet: dict[str, object], said: str
) -> None:
    def spoil(table: dict[str, np.ndarray]) -> None:
        table["tau1"] = change(table["tau1"])

    sheet |= {"armature": [0.3, 0.1], "coulomb": [2, 1], "viscous": [1, 0.5]}
    check = check_case(make_case(spoil=spoil, nominal=sheet))
    assert f"joint 1: {said}" in warned(check)


def test_jitter_and_a_low_rate_are_said(make_case: Make) -> None:
    def shake(table: dict[str, np.ndarray]) -> None:
        noise = np.random.default_rng(0).uniform(0, 0.002, len(table["t"]))
        table["t"] = 6 * (table["t"] + noise)

    text = warned(check_case(make_case(spoil=shake)))
    assert "log at 100 Hz or more" in text and "Time stamps (jitter)" in text


def test_pauses_are_no_jitter_and_a_slow_log_is_not_in_milliseconds(
    make_case: Make,
) -> None:
    def pause(table: dict[str, np.ndarray]) -> None:
        table["t"] = table["t"] + 5.0 * (np.arange(len(table["t"])) > 1500)

    def slow(table: dict[str, np.ndarray]) -> None:
        table.update({name: column[::35] for name, column in table.items()})

    text = warned(check_case(make_case(spoil=pause)))
    assert (
        "gaps in time: 1" in text and "rate:" not in text and "Time stamps" not in text
    )
    check = check_case(make_case(spoil=slow))
    assert "the rate is 7.14 Hz" in warned(check) and "looks like" not in warned(check)
    assert not check["can_be_diagnosed"]


def test_degrees_are_a_fault_that_the_diagnosis_tests(make_case: Make) -> None:
    check = check_case(make_case(spoil=in_degrees))
    assert "looks like degrees" in warned(check) and "tests for this fault" in warned(
        check
    )
    assert check["can_be_diagnosed"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"judge": ["recording_0.csv"]}, "recording_0.csv is held out and is fitted"),
        ({"robot": "nothing.urdf"}, "nothing.urdf"),
        ({"recordings": ["nothing.csv"]}, "nothing.csv"),
        ({"surprise": 1}, "unknown key 'surprise'"),
        ({"import": {"tau": None}, "controller": None}, "no recording carries a torque"),
    ],
)  # fmt: skip
def test_what_cannot_be_diagnosed_is_an_error_with_a_remedy(
    make_case: Make, change: dict[str, object], said: str
) -> None:
    check = check_case(make_case(**change))
    errors = [x for x in check["remarks"] if x["level"] == "error"]
    assert len(errors) == 1 and said in errors[0]["said"] and errors[0]["remedy"]


def test_the_command_ends_with_0_or_2_and_writes_valid_json(
    make_case: Make, command: Callable[..., Any]
) -> None:
    folder = make_case()
    done = command("check", folder, "--json")
    content = json.loads(done.out)
    check_document(content, "check")
    assert done.code == 0 and content["joints"][1]["reversals"] > 10
    (folder / "robot.urdf").unlink()
    done = command("check", folder)
    assert done.code == 2 and "cannot be diagnosed" in done.out
