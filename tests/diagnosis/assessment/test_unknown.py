"""What a flexible model predicts of what is left: noise not at all, a curve by its variable, a hum by its frequency."""

from __future__ import annotations

from functools import cache
from typing import Any

import documents
import numpy as np
import pytest

from gapscope.diagnosis.assessment.unknown import Predictable, Unknown, unknown
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.locate import MotionRows
from gapscope.model.conditioning import low_pass
from gapscope.model.torque_gap import TorqueGap
from gapscope.reports.diagnosis import render

RATE, SECONDS, N = 250.0, 20.0, 6
NOISE, SCALE = 0.1, 5.0


@cache
def rows(recordings: int = 3, seconds: float = SECONDS) -> MotionRows:
    """Sums of sines of three joints, other ones in each recording."""
    t, parts = np.arange(int(seconds * RATE)) / RATE, []
    for seed in range(recordings):
        rng = np.random.default_rng(seed)
        w, a, p = (
            rng.uniform(low, high, (4, N))
            for low, high in ((0.5, 3.0), (0.2, 0.5), (0.0, 6.0))
        )
        angle = w * t[:, None, None] + p
        waves = a * np.sin(angle), a * w * np.cos(angle), -a * w**2 * np.sin(angle)
        parts.append([wave.sum(axis=1)[:, :3] for wave in waves])
    q, dq, ddq = map(np.vstack, zip(*parts, strict=True))
    segment, times = np.repeat(np.arange(recordings), len(t)), np.tile(t, recordings)
    return MotionRows(times, q, dq, ddq, segment, (RATE,) * recordings)


def what_is_left(left: np.ndarray, at: MotionRows) -> Unknown:
    """Of a torque that is left on joint 1 of three, with noise on top."""
    noise = np.random.default_rng(9).standard_normal((len(at.t), N))[:, :3]
    error = low_pass(np.sqrt(RATE / 24.0) * NOISE * noise, RATE, 12.0)
    error[:, 0] += left
    load = 20.0 * np.cos(at.q)
    return of_gap(error, load, at, (NOISE / SCALE) ** 2)


def thinned(
    error: np.ndarray, load: np.ndarray, at: MotionRows
) -> tuple[TorqueGap, MotionRows]:
    """Every eighth row of a gap beside a load: about as many as its band asks for."""
    error, load, *series = (
        x[::8] for x in (error, load, at.t, at.q, at.dq, at.ddq, at.segment)
    )
    rates = tuple(rate / 8 for rate in at.rates)
    return TorqueGap(load + error, load), MotionRows(*series, rates)


def of_gap(
    error: np.ndarray, load: np.ndarray, at: MotionRows, white2: Any = 0.0
) -> Unknown:
    """Of a gap beside a load, all of whose rows are known."""
    gap, at = thinned(error, load, at)
    n = load.shape[1]
    noise = np.broadcast_to(white2, n)
    return unknown(gap, at, np.ones_like(gap.error), np.full(n, SCALE), noise)


def found(left: np.ndarray, at: MotionRows) -> Predictable:
    """What is predicted of it on joint 1."""
    return what_is_left(left, at).predictable[0]


def test_noise_is_white_and_cannot_be_predicted() -> None:
    at = rows()
    said = what_is_left(np.zeros(len(at.t)), at)
    for joint in said.predictable:
        assert joint.share < 0.05 and max(joint.by.values()) < 0.05
        assert joint.whiteness_p > 1e-3
    assert not said.joints and not said.torque2.any()


@pytest.mark.parametrize(("size", "joints"), [(0.01, []), (0.04, [1])])
def test_an_unknown_cause_has_a_size_that_is_worth_a_search(
    size: float, joints: list[int]
) -> None:
    at = rows()
    torque = size * SCALE * np.sqrt(2.0) * np.sin(6.0 * at.q[:, 0])
    said = what_is_left(torque, at)
    assert said.joints == joints
    if joints:
        of_cause = np.sqrt(said.torque2[0]) / SCALE
        assert of_cause == pytest.approx(size, rel=0.15)


def errors_of_form(sizes: list[float]) -> Unknown:
    """Of errors of joints' torque of such RMS over its deviation: half of the squares follow the motion."""
    at = rows()
    rng = np.random.default_rng(4)
    wander = low_pass(rng.standard_normal((len(at.t), len(sizes))), RATE, 2.0)
    load = 20.0 * np.cos(at.q[:, : len(sizes)])
    waves = np.sin(6.0 * at.q[:, : len(sizes)])
    error = waves + np.sqrt(0.5) * wander / wander.std(axis=0)
    return of_gap(SCALE * error * sizes, load, at)


@pytest.mark.parametrize(
    ("sizes", "joints"),
    [
        ([0.1, 0.12, 0.08], []),  # a real arm: errors of form everywhere
        ([0.02, 0.12, 0.03], [2]),  # a cause stands out
        ([0.2, 0.3, 0.25], [2, 3]),  # more than healthy arms leave
        ([0.1], []),
        ([0.22], [1]),
    ],
)
def test_a_cause_stands_out_from_what_healthy_arms_leave_everywhere(
    sizes: list[float], joints: list[int]
) -> None:
    assert errors_of_form(sizes).joints == joints


def test_an_oscillation_that_follows_no_motion_is_no_error_of_form() -> None:
    at = rows()
    load = 20.0 * np.cos(at.q[:, :3])
    hum = 0.1 * SCALE * np.sin(2.0 * np.pi * 6.385 * at.t + at.segment)
    error = hum[:, None] * [1.0, 1.1, 0.9]
    assert of_gap(error, load, at).joints == [1, 2, 3]


@pytest.mark.parametrize(("late", "joints"), [(0.8e-3, []), (8e-3, [1, 2, 3])])
def test_a_skew_between_torque_and_motion_is_no_cause_but_a_delay_is(
    late: float, joints: list[int]
) -> None:
    at = rows()
    # a loop that rings while the arm moves fast, as its torque is recorded late
    ringing = 20.0 * np.sin(2.0 * np.pi * 6.0 * (at.t[:, None] - [[[0.0]], [[late]]]))
    load = 20.0 * np.cos(at.q) + ringing * [1.0, 1.2, 0.8]
    assert of_gap(load[1] - load[0], load[0], at).joints == joints


@pytest.mark.parametrize(("size", "joints"), [(0.08, []), (0.3, [1])])
def test_what_does_not_come_again_has_a_cause_if_no_healthy_joint_leaves_so_much(
    size: float, joints: list[int]
) -> None:
    """A torque that wanders slowly, whatever the motion, beside noise of 2 % of the torque."""
    at = rows()
    wander = np.cumsum(np.random.default_rng(3).standard_normal(len(at.t)))
    said = what_is_left(size * SCALE * wander / np.sqrt((wander**2).mean()), at)
    assert said.left[0] > (0.02 * SCALE) ** 2
    assert said.joints == joints


def test_noise_of_one_joint_has_no_cause_however_large() -> None:
    at = rows()
    size = NOISE * np.array([20.0, 1.0, 1.0])
    white = np.random.default_rng(2).standard_normal((len(at.t), 3))
    error = low_pass(np.sqrt(RATE / 24.0) * size * white, RATE, 12.0)
    load, white2 = 20.0 * np.cos(at.q), (size / SCALE) ** 2
    assert of_gap(error, load, at, white2).joints == []
    # an encoder that is read coarsely leaves noise of any size
    assert of_gap(error, load, at, np.array([np.inf, *white2[1:]])).joints == []
    # of the same size, but not known as noise
    assert of_gap(error, load, at, white2[1]).joints == [1]


def test_rows_on_which_a_joint_may_stick_say_nothing() -> None:
    at = rows()
    sticks = np.abs(at.dq[:, 0]) < 0.3
    load = 20.0 * np.cos(at.q[:, :3])
    error = 1e-3 * np.random.default_rng(1).standard_normal(load.shape)
    error[sticks, 0] = 0.1 * SCALE * np.sign(at.dq[sticks, 0])
    (gap, at), scale = thinned(error, load, at), np.full(3, SCALE)
    trust = np.ones_like(gap.error)
    noise2 = np.zeros(3)
    assert unknown(gap, at, trust, scale, noise2).joints == [1]
    trust[sticks[::8], 0] = 0.01
    assert unknown(gap, at, trust, scale, noise2).joints == []


CAUSES = {
    "position": lambda at: 0.6 * np.sin(6.0 * at.q[:, 0]),
    "velocity": lambda at: 0.5 * np.tanh(at.dq[:, 0] / 0.7) - 0.5 * at.dq[:, 0] ** 2,
    "direction": lambda at: 0.5 * np.sign(at.dq[:, 0]),
    "acceleration": lambda at: 0.1 * at.ddq[:, 0] * np.abs(at.ddq[:, 0]),
    "load": lambda at: 0.5 * np.cos(at.q[:, 0]) ** 3,
    "time": lambda at: np.exp(-at.t / 3.0),
    "frequency": lambda at: 0.5 * np.sin(2 * np.pi * 6.385 * at.t + at.segment),
}


@pytest.mark.parametrize("name", CAUSES)
def test_each_variable_is_told_by_its_gap(name: str) -> None:
    at = rows()
    left = CAUSES[name](at)
    said = found(left, at)
    assert said.share > 0.75, said
    assert said.by[name] > 0.75
    assert said.by[name] >= max(said.by.values()) - 0.05
    assert said.whiteness_p < 1e-6
    if name in ("position", "velocity"):
        x = {"position": at.q, "velocity": at.dq}[name][:, 0]
        assert said.curve.variable == name
        error = left - np.interp(x, said.curve.x, said.curve.y)
        assert np.std(error) < 0.4 * np.std(left)
    if name == "frequency":
        assert abs(said.curve.x[np.argmax(said.curve.y)] - 6.385) < 0.1
        assert said.curve.y.max() == pytest.approx(0.5, rel=0.2)


def test_several_variables_together_predict_what_none_does_alone() -> None:
    at = rows()
    said = found(np.sin(3.0 * at.q[:, 0]) * np.tanh(at.dq[:, 0] / 0.5), at)
    assert said.share > 0.6 > max(said.by.values()) + 0.2


def test_hysteresis_is_told_by_what_a_joint_remembers() -> None:
    """A spring to a plate that slides: no function of the state, and the same when the motion comes again."""
    at, state, strain = rows(), 0.0, []
    for step in np.diff(at.q[:, 0], prepend=at.q[0, 0]).tolist():
        state = min(max(state + step, -0.2), 0.2)
        strain.append(state)
    assert found(4.0 * np.array(strain), at).share > 0.9


def test_one_recording_is_judged_on_its_halves() -> None:
    at = rows(1, 40.0)
    assert found(0.6 * np.sin(3.0 * at.q[:, 0]), at).by["position"] > 0.7


def test_it_is_in_the_document_and_in_the_report(tmp_path) -> None:
    at, document = rows(), documents.unexplained()
    entry = found(CAUSES["position"](at), at).document()
    document["unexplained"]["predictable"] = [{**entry, "joint": 4}]
    validate(document)
    render(documents.diagnosis(document), tmp_path / "report.html")
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    said = ("J4: ", "can be predicted", 'data-guess="0"', "Its position alone")
    assert [text for text in said if text not in html] == []
