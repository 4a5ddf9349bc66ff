"""Friction that data sheet or URDF states and the arm does not have: a finding, with its source in the files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
from synthetic import Truth

from gapscope.arm.robots import load_nominal_arm
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.document.wording import nominal_friction_sentence

STATED = '<dynamics damping="10.0" friction="0.5"/>'


def test_an_arm_without_the_friction_of_its_data_sheet_is_found_at_the_bound() -> None:
    without = Truth(coulomb=(-2.0, -3.0, -1.0), viscous=(-2.0, -3.0, -1.0))
    document = diagnose(synthetic.case(without, seed=3)).document
    found = {e["effect"]: e for e in document["effects"]}
    assert set(found) == {"coulomb_friction", "viscous_friction"}
    assert document["verdict"] == "effects_found" and document["closed"] > 0.95
    for effect, name in (
        ("coulomb_friction", "torque"),
        ("viscous_friction", "coefficient"),
    ):
        values = found[effect]["parameters"][name]["value"]
        np.testing.assert_allclose(values, [-2.0, -3.0, -1.0], atol=0.05)
        assert (np.array(values) >= [-2.0, -3.0, -1.0]).all()


def test_document_states_the_friction_and_its_source() -> None:
    case = synthetic.case(duration=4.0)
    arm = replace(case.arm, friction_source="data sheet")
    document = diagnose(replace(case, arm=arm, recordings=case.recordings[1:])).document
    assert document["nominal"]["friction"] == {
        "source": "data sheet",
        "coulomb": [2.0, 3.0, 1.0],
        "viscous": [2.0, 3.0, 1.0],
    }
    assert (
        nominal_friction_sentence(document)
        == "Coulomb 1.00 to 3.00 N m and viscous 1.00 to 3.00 N m s/rad (from data sheet)"
    )


@pytest.mark.parametrize(
    ("sheet", "source"),
    [
        (None, "robot.urdf <dynamics>"),
        ({"coulomb": [1.0] * 3, "viscous": [1.0] * 3}, "data sheet"),
        (
            {"coulomb": [1.0] * 3},
            "coulomb from data sheet, viscous from robot.urdf <dynamics>",
        ),
        ({"coulomb": [0.0] * 3, "viscous": [0.0] * 3}, ""),
    ],
)
def test_source_of_the_friction_is_known(
    tmp_path: Path, sheet: dict[str, list[float]] | None, source: str
) -> None:
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(synthetic.URDF.replace("<limit", STATED + "<limit"))
    assert load_nominal_arm(urdf, sheet=sheet).friction_source == source
