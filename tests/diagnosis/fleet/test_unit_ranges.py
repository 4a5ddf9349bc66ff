"""Ranges from the files of diagnoses: which deviation belongs to which value, and files that do not fit."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import documents
import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.arm.io.json_file import write_json
from gapscope.arm.robots import load_nominal_arm
from gapscope.diagnosis.fleet.unit_ranges import read_ranges
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import write_corrected


def written(folder: Path, delay: list[float], std: Any) -> CorrectedArm:
    """The files of a diagnosis with a delay of joints 4 and 5."""
    folder.mkdir()
    document = copy.deepcopy(documents.one_possible())
    (finding,) = document["effects"]
    finding["parameters"] = {"delay": {"unit": "s", "value": delay, "std": std}}
    write_json(document, folder / "diagnosis.json")
    effects = (AppliedEffect("actuator_delay", (4, 5), {"delay": delay}),)
    write_corrected("unit", effects, folder / "corrected.yaml")
    return CorrectedArm(load_nominal_arm("xarm6"), effects)


def test_one_unit_has_the_intervals_of_its_diagnosis(tmp_path: Path) -> None:
    arm = written(tmp_path / "a", [0.008, 0.014], [0.001, None])
    (found,) = read_ranges(tmp_path / "a" / "corrected.yaml", arm, ()).ranges
    value, half = np.array([0.008, 0.014]), np.array([0.00196, 0.0])
    assert found.low.parameters["delay"] == pytest.approx(value - half)
    assert found.high.parameters["delay"] == pytest.approx(value + half)


def test_two_units_span_both(tmp_path: Path) -> None:
    arm = written(tmp_path / "a", [0.008, 0.014], [0.0, 0.0])
    written(tmp_path / "b", [0.010, 0.012], [0.0, 0.0])
    file = tmp_path / "a" / "corrected.yaml"
    (found,) = read_ranges(file, arm, (tmp_path / "b",)).ranges
    assert found.low.parameters["delay"] == pytest.approx([0.008, 0.012])
    assert found.high.parameters["delay"] == pytest.approx([0.010, 0.014])


def test_a_changed_file_is_not_given_the_intervals_of_another(tmp_path: Path) -> None:
    written(tmp_path / "a", [0.008, 0.014], [0.0, 0.0])
    effects = (AppliedEffect("actuator_delay", (4, 5), {"delay": [0.008, 0.02]}),)
    write_corrected("unit", effects, tmp_path / "a" / "corrected.yaml")
    arm = CorrectedArm(load_nominal_arm("xarm6"), effects)
    with pytest.raises(InputError, match="no actuator_delay with the values") as error:
        read_ranges(tmp_path / "a" / "corrected.yaml", arm, ())
    assert error.value.file == tmp_path / "a" / "diagnosis.json"


def test_a_missing_diagnosis_is_told(tmp_path: Path) -> None:
    arm = written(tmp_path / "a", [0.008, 0.014], [0.0, 0.0])
    (tmp_path / "a" / "diagnosis.json").unlink()
    with pytest.raises(InputError, match=r"diagnosis\.json"):
        read_ranges(tmp_path / "a" / "corrected.yaml", arm, ())
