"""What a flexible model predicts of what is left: noise not at all, a curve by its variable, a hum by its frequency."""

from __future__ import annotations

import time

import documents
import numpy as np
import pytest

from gapscope.diagnosis.assessment.predictable_share import Predictable, predictable
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.localisation.stacked_rows import MotionRows
from gapscope.model.conditioning import low_pass
from gapscope.model.torque_gap import TorqueGap
from gapscope.reports.diagnosis import render

RATE, SECONDS, N = 250.0, 20.0, 6
FLOOR = np.full(N, 0.1)


def rows(recordings: int = 3, seconds: float = SECONDS) -> MotionRows:
    """Sums of sines, other ones in each recording."""
    count, parts = int(seconds * RATE), []
    for seed in range(recordings):
        rng = np.random.default_rng(seed)
        t = np.arange(count) / RATE
        w, a, p = (
            rng.uniform(0.5, 3.0, (4, N)),
            rng.uniform(0.2, 0.5, (4, N)),
            rng.uniform(0.0, 6.0, (4, N)),
        )
        angle = w * t[:, None, None] + p
        parts.append(
            [
                (a * f * g(angle)).sum(axis=1)
                for f, g in ((1, np.sin), (w, np.cos), (-(w**2), np.sin))
            ]
        )
    q, dq, ddq = (np.vstack(x) for x in zip(*parts, strict=True))
    segment = np.repeat(np.arange(recordings), count)
    return MotionRows(
        np.tile(np.arange(count) / RATE, recordings),
        q,
        dq,
        ddq,
        segment,
        (RATE,) * recordings,
    )


def found(
    left: np.ndarray, at: MotionRows, joint: int = 1, floor: np.ndarray = FLOOR
) -> Predictable:
    """What is predicted of a torque that is left on joint 1, with noise at the floor on top."""
    noise = np.random.default_rng(9).standard_normal((len(at.t), N))
    error = low_pass(np.sqrt(RATE / 24.0) * floor[0] * noise, RATE, 12.0)
    error[:, 0] += left
    load = 20.0 * np.cos(at.q)
    gap = TorqueGap(load + error, load, (0, len(at.t)))
    return predictable(gap, at, floor, [joint])[0]


def test_noise_is_white_and_cannot_be_predicted() -> None:
    at = rows()
    said = found(np.zeros(len(at.t)), at, floor=0.6 * FLOOR)
    loud = found(np.zeros(len(at.t)), at)
    assert loud.share == 0.0 and said.share < 0.05 and max(said.by.values()) < 0.05
    noise = found(np.zeros(len(at.t)), at, joint=2)
    assert noise.whiteness_p > 1e-3


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


def test_one_recording_is_judged_on_its_halves() -> None:
    at = rows(1, 40.0)
    assert found(0.6 * np.sin(3.0 * at.q[:, 0]), at).by["position"] > 0.7


def test_it_is_quick_and_the_same_every_time() -> None:
    at = rows()
    gap = TorqueGap(
        np.random.default_rng(0).standard_normal((len(at.t), N)),
        20.0 * np.cos(at.q),
        (0, len(at.t)),
    )
    start = time.process_time()
    first = predictable(gap, at, FLOOR, [1, 2, 3])
    assert time.process_time() - start < 4.0  # 60 s of recordings, three open joints
    assert [p.document() for p in first] == [
        p.document() for p in predictable(gap, at, FLOOR, [1, 2, 3])
    ]
    assert predictable(gap, at, FLOOR, []) == []


def test_it_is_in_the_document_and_in_the_report(tmp_path) -> None:
    at, document = rows(), documents.unexplained()
    entry = found(CAUSES["position"](at), at).document()
    document["unexplained"]["predictable"] = [{**entry, "joint": 4}]
    validate(document)
    render(documents.diagnosis(document), tmp_path / "report.html")
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert (
        "J4: " in html
        and "can be predicted" in html
        and 'data-guess="0"' in html
        and "Its position alone" in html
    )
