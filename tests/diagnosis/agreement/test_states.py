"""Every diagnosis of several recordings asks first whether they share a state."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import HEAVY, chain
from cases import case_of, simulated_case
from synthetic import Truth, arm, motion, recording

import gapscope
from gapscope.arm.case import Case
from gapscope.arm.recording import Recording
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.document.wording import verdict_sentence
from gapscope.effects.applied import AppliedEffect
from gapscope.interface.diagnose import DiagnosisResult

LOAD = Truth(mass=1.5, com=(0.2, 0.0, 0.05))


def case(*truths: Truth) -> Case:
    """A recording of each truth, at different speeds."""
    rng = np.random.default_rng(3)
    found = (
        recording(truth, motion(k, 0.1 + 0.05 * k, 8.0), rng, f"recording_{k}.csv")
        for k, truth in enumerate(truths)
    )
    return case_of("tools", arm(), *found)


def assert_predicted(result: DiagnosisResult, *recordings: Recording) -> None:
    """The corrected arm leaves less than a tenth of the torque of each recording on every joint."""
    for one in recordings or result.case.recordings:
        predicted = gapscope.predict(result.case, one.name, result.corrected).tau
        gap = (one.tau - predicted)[100:-100]
        assert (gap.std(axis=0) < 0.1 * one.tau.std(axis=0)).all()


def test_a_tool_on_one_recording_is_said_first_and_named_there() -> None:
    result = gapscope.diagnose(case(Truth(), LOAD, Truth()))
    document = dict(result.document)
    validate(document)
    states = document["states"]
    assert not states["shared"]
    assert states["diagnosed"] == ["recording_0.csv", "recording_2.csv"]
    (load,) = states["differs"]
    assert load["name"] == "load on the last link" and load["probability"] > 0.9
    assert load["values"] == pytest.approx([0.0, 1.5, 0.0], abs=0.05)
    assert load["parameters"][1]["com"] == pytest.approx([0.2, 0.0, 0.05], abs=0.03)
    text = verdict_sentence(document)
    assert text.startswith("The recordings do not share a state: load on the last link")
    assert "1.5" in text and "gapscope agree" in text
    (found,) = document["effects"]
    assert document["verdict"] == "effects_found"
    assert found["effect"] == "payload" and found["recordings"] == ["recording_1.csv"]
    assert found["parameters"]["mass"]["value"] == pytest.approx(1.5, abs=0.05)
    assert_predicted(result)


def test_a_tool_on_the_other_side_is_another_load() -> None:
    other = Truth(mass=1.5, com=(0.05, 0.0, 0.05))
    result = gapscope.diagnose(case(LOAD, other))
    document = result.document
    (found,) = (e for e in document["effects"] if e["effect"] == "payload")
    assert found["recordings"] == ["recording_0.csv"]
    (there,) = found["elsewhere"]
    assert there["recordings"] == ["recording_1.csv"]
    values = [place["parameters"] for place in (found, there)]
    assert [v["mass"]["value"] for v in values] == pytest.approx([1.5, 1.5], abs=0.1)
    levers = [v["com"]["value"][0] for v in values]
    assert levers == pytest.approx([0.2, 0.05], abs=0.02)
    assert_predicted(result)


def test_a_reference_tells_the_load_of_each_recording() -> None:
    reference = case(Truth(), Truth())
    result = gapscope.diagnose(case(Truth(), LOAD), against=reference)
    (found,) = result.document["effects"]
    assert found["effect"] == "payload" and found["recordings"] == ["recording_1.csv"]
    validate(dict(result.document))
    assert_predicted(result)


@pytest.mark.nightly
def test_what_is_judged_is_judged_in_the_state_it_shares() -> None:
    made = case(Truth(), LOAD, Truth(), LOAD)
    first, second, *judged = made.recordings
    apart = replace(made, recordings=(first, second), judged=tuple(judged))
    result = gapscope.diagnose(apart)
    document = result.document
    assert document["states"]["recordings"] == ["recording_0.csv", "recording_1.csv"]
    (diagnosed,) = document["states"]["diagnosed"]
    judges = [r["name"] for r in document["recordings"] if r["role"] == "judge"]
    assert judges == (
        ["recording_2.csv"] if diagnosed == "recording_0.csv" else ["recording_3.csv"]
    )
    assert document["verdict"] == "effects_found"
    assert_predicted(result, *judged)


def test_a_difference_that_nobody_sees_is_no_effect(tmp_path: Path) -> None:
    """It is told from the other recordings by its evidence, and is far below what an effect closes."""
    made = chain(tmp_path, "two", *HEAVY, armature=[0.1, 0.1], coulomb=[1.0, 1.0])
    little = AppliedEffect("coulomb_friction", (2,), {"torque": [0.02]})
    how = {"seed": 1, "frequencies": (0.2, 0.15, 0.25), "duration": 10.0}
    alike, other = (
        simulated_case(tmp_path, "a", made, some, **how, rate=100.0, noise=0.002)
        for some in ((), (little,))
    )
    recordings = (*alike.recordings[:2], other.recordings[2])
    document = dict(gapscope.diagnose(replace(alike, recordings=recordings)).document)
    validate(document)
    assert not document["states"]["shared"] and document["effects"] == []
    assert document["verdict"] == "no_gap"
