"""Which values and findings the coverage of intervals is counted from, on a label and a diagnosis made by hand."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import pytest

coverage = import_module("51_interval_coverage")
calibration_table, stated = coverage.calibration_table, coverage.stated
coverage_table, values = coverage.coverage_table, coverage.values


def entry(name: str, joints: list[int], stds: Any = (), p: float = 1.0, **values: Any):
    """An effect of a label, or of a diagnosis with deviations and a probability."""
    units = {"torque": "N m", "mass": "kg", "com": "m", "radius": ""}
    parameters = {key: {"unit": units[key], "value": values[key]} for key in values}
    for key, std in dict(stds).items():
        parameters[key]["std"] = std
    found = {"effect": name, "joints": joints, "probability": p}
    return found | {"parameters": parameters}


TRUTH = {
    "effects": [
        entry("coulomb_friction", [2, 5], torque=[1.0, 2.0]),
        entry("payload", [], mass=1.5, com=[0.0, 0.1, 0.2], radius=0.03),
    ],
    "gap": [0.0] * 6,
}
STDS = {"mass": 0.01, "com": [0.1] * 3}
FOUND = {
    "effects": [
        entry("coulomb_friction", [5, 6], {"torque": [0.1] * 2}, 0.9, torque=[2.1, 0.3]),
        entry("payload", [], STDS, 0.6, mass=1.4, com=[0.0, 0.1, 0.3]),
    ],
    "possible": [entry("armature", [1], p=0.2)],
}  # fmt: skip


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
