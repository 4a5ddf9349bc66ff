"""Every diagnosis of several recordings asks first whether they share a state."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import Truth, arm, motion, recording

from gapscope.arm.case import Case
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.document.sentences import verdict_sentence

LOAD = Truth(mass=1.5, com=(0.2, 0.0, 0.05))


def case(*truths: Truth) -> Case:
    """A recording of each truth, at different speeds."""
    rng = np.random.default_rng(3)
    found = tuple(
        recording(truth, motion(k, 0.1 + 0.05 * k, 8.0), rng, f"recording_{k}.csv")
        for k, truth in enumerate(truths)
    )
    return Case("tools", arm().urdf.parent, arm(), found)


def test_a_tool_on_one_recording_is_said_first() -> None:
    document = dict(diagnose(case(Truth(), LOAD, Truth())).document)
    validate(document)
    states = document["states"]
    assert not states["shared"]
    (load,) = states["differs"]
    assert load["name"] == "load on the last link" and load["probability"] > 0.9
    assert load["values"] == pytest.approx([0.0, 1.5, 0.0], abs=0.05)
    assert load["parameters"][1]["com"] == pytest.approx([0.2, 0.0, 0.05], abs=0.03)
    text = verdict_sentence(document)
    assert text.startswith("The recordings do not share a state: load on the last link")
    assert "1.5" in text and "gapscope agree" in text


def test_recordings_that_share_a_state_need_no_sentence() -> None:
    document = diagnose(case(LOAD, LOAD)).document
    assert document["states"]["shared"] and document["states"]["differs"] == []
    assert "share a state" not in verdict_sentence(document)
    assert [effect["effect"] for effect in document["effects"]] == ["payload"]


def test_a_single_recording_is_not_asked() -> None:
    assert "states" not in diagnose(case(Truth())).document
