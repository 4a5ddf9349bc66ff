"""Which values and findings the coverage of intervals is counted from, on a label and a diagnosis made by hand."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "experiments"))
coverage = import_module("51_interval_coverage")
calibration_table, stated = coverage.calibration_table, coverage.stated
coverage_table, values = coverage.coverage_table, coverage.values

TRUTH = {
    "effects": [
        {
            "effect": "coulomb_friction",
            "joints": [2, 5],
            "parameters": {"torque": {"unit": "N m", "value": [1.0, 2.0]}},
        },
        {
            "effect": "payload",
            "joints": [],
            "parameters": {
                "mass": {"unit": "kg", "value": 1.5},
                "com": {"unit": "m", "value": [0.0, 0.1, 0.2]},
                "radius": {"unit": "", "value": 0.03},
            },
        },
    ],
    "gap": [0.0] * 6,
}
FOUND = {
    "effects": [
        {
            "effect": "coulomb_friction",
            "joints": [5, 6],
            "probability": 0.9,
            "parameters": {
                "torque": {"unit": "N m", "value": [2.1, 0.3], "std": [0.1, 0.1]}
            },
        },
        {
            "effect": "payload",
            "joints": [],
            "probability": 0.6,
            "parameters": {
                "mass": {"unit": "kg", "value": 1.4, "std": 0.01},
                "com": {"unit": "m", "value": [0.0, 0.1, 0.3], "std": [0.1] * 3},
            },
        },
    ],
    "possible": [
        {"effect": "armature", "joints": [1], "probability": 0.2, "parameters": {}}
    ],
}


def test_values_are_those_of_joints_that_have_the_effect() -> None:
    found = list(values("3 %", TRUTH, FOUND))
    assert [(v.parameter, v.true, v.found) for v in found] == [
        ("coulomb_friction.torque", 2.0, 2.1),
        ("payload.mass", 1.5, 1.4),
        ("payload.com", 0.0, 0.0),
        ("payload.com", 0.1, 0.1),
        ("payload.com", 0.2, 0.3),
    ]
    assert [v.held for v in found] == [True, False, True, True, True]
    assert found[0].half == pytest.approx(0.196)
    table = coverage_table("All", found)
    assert table.rows[-1][:3] == ("all", "5", "80 %")


def test_findings_are_right_if_the_label_has_them() -> None:
    found = stated(TRUTH, FOUND)
    assert found == [(0.9, True), (0.6, True), (0.2, False)]
    row = calibration_table("All", [("arm", *one) for one in found]).rows[-1]
    assert row[:4] == ("all", "3", "0.57", "0.67") and row[-1].startswith("1, 0.90")
