"""Standard deviations of findings against a reference."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.diagnosis.reference.reference_json import _widened
from gapscope.diagnosis.reference.reference_uncertainty import EffectColumns


def columns(effect: str, joint: int) -> EffectColumns:
    return EffectColumns(effect, joint, np.zeros((1, 1, 1)))


def parameter(value: object, std: object) -> dict[str, object]:
    return {"unit": "1", "value": value, "std": std}


def test_a_fault_without_joints_keeps_its_values():
    fault = {
        "effect": "time_stamps",
        "joints": [],
        "parameters": {"amount": parameter(0.01, None)},
    }
    assert _widened(fault, [(columns("payload", 0), np.eye(4))]) == fault


def test_a_scale_is_at_least_as_uncertain_as_the_reference_leaves_it():
    effect = {
        "effect": "torque_scale",
        "joints": [2],
        "parameters": {"scale": parameter([0.2], [0.001])},
    }
    covariance = np.array([[0.09]])  # a relative deviation of 0.3
    widened = _widened(effect, [(columns("torque_scale", 2), covariance)])
    assert widened["parameters"]["scale"]["std"] == pytest.approx([0.06])
