"""The arm in 3D as data: drawn also if no engine could move it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import documents
import numpy as np
import pytest

from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.diagnosis.assessment.replay_gap import ReplayedMotion
from gapscope.diagnosis.result import Diagnosis
from gapscope.reports.diagnosis import arm_scene


@pytest.fixture(scope="module")
def weightless(tmp_path_factory: pytest.TempPathFactory) -> NominalArm:
    """The iiwa with a last link that has no moment of inertia, as published models have."""
    arm = load_nominal_arm("kuka_iiwa")
    text = arm.urdf.read_text(encoding="utf-8")
    start = text.rindex("<inertia ")
    end = text.index("/>", start)
    none = '<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"'
    file: Path = tmp_path_factory.mktemp("arm") / "weightless.urdf"
    file.write_text(text[:start] + none + text[end:], encoding="utf-8")
    return load_nominal_arm(file)


def diagnosed(arm: NominalArm, *, replayed: bool) -> Diagnosis:
    diagnosis = documents.diagnosis(documents.two_effects())
    trace = diagnosis.traces[0]
    motion = ReplayedMotion(trace.recording, trace.t, trace.q, None, 1.1 * trace.q)
    return replace(diagnosis, arm=arm, replayed=motion if replayed else None)


def test_an_arm_that_no_engine_can_move_is_drawn(weightless):
    scene = arm_scene(diagnosed(weightless, replayed=False))
    assert len(scene["joints"]) == 7 and scene["hulls"]
    assert list(scene["motion"]["arms"]) == ["recorded"]


def test_simulated_arms_stand_beside_the_recorded_one():
    scene = arm_scene(diagnosed(load_nominal_arm("kuka_iiwa"), replayed=True))
    assert list(scene["motion"]["arms"]) == ["recorded", "corrected"]
    # joints stand on their parents, in order
    assert [joint["parent"] for joint in scene["joints"]] == [-1, 0, 1, 2, 3, 4, 5]
    for joint in scene["joints"]:
        assert np.linalg.norm(joint["axis"]) == pytest.approx(1.0)


def test_without_an_arm_there_is_no_scene():
    assert arm_scene(documents.diagnosis(documents.two_effects())) is None
