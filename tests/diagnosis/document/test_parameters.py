"""Parameters of a finding: values, deviations of the draws and of the scan, and the skew of sampling."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import selections
from selections import TERMS, TableEvidence, term

from gapscope.diagnosis.document.parameters import finding_of, parameters
from gapscope.effects.applied import AppliedEffect
from gapscope.model.terms import Term

DRAWS = 1001
QUANTILE = 0.95 / 1.96
"""Deviation of which 1.96 to either side hold 95 % of draws that spread evenly by 1 to either side."""


def uniform(*terms: Term, width: float, about: float = 0.0) -> np.ndarray:
    """Draws that spread evenly by a width to either side of a value in all columns of some terms."""
    draws = np.zeros((DRAWS, TERMS.size))
    for t in terms:
        places = list(t.columns)
        draws[:, places] = about + np.linspace(-width, width, DRAWS)[:, None]
    return draws


def entries(
    effect: AppliedEffect, draws: np.ndarray, *terms: Term, std: Any = (), **more: Any
) -> dict[str, Any]:
    scan = SimpleNamespace(values=tuple(0.5 for _ in std), std=std)
    evidence = TableEvidence()
    object.__setattr__(evidence, "linear", SimpleNamespace(nonlinear=lambda term: scan))
    found = selections.selection(*terms, evidence=evidence)
    return parameters(found, effect, draws, **more)


def test_a_finding_is_an_effect_or_an_effect_on_one_link() -> None:
    assert finding_of(AppliedEffect("armature", (1,), {"inertia": [0.1]})) == "armature"
    link = AppliedEffect(
        "link_inertia", (), {"link": 2.0, "mass": 0.1, "com": [0.0, 0.0, 0.0]}
    )
    assert finding_of(link) == "link_inertia 2"


def test_deviations_are_those_of_the_draws() -> None:
    joints = term("coulomb_friction", 1), term("coulomb_friction", 2)
    effect = AppliedEffect("coulomb_friction", (1, 2), {"torque": [0.5, 0.5]})
    out = entries(effect, uniform(*joints, width=0.2, about=0.5), *joints)
    assert out["torque"]["unit"] == "N m" and out["torque"]["value"] == [0.5, 0.5]
    assert out["torque"]["std"] == pytest.approx([0.2 * QUANTILE] * 2, rel=1e-2)
    assert "by_commands" not in out["torque"]


def test_draws_that_lie_to_one_side_of_a_value_are_held_as_well() -> None:
    """Under larger errors of the nominal arm other values are likely than the one that is stated."""
    joint = term("coulomb_friction", 1)
    effect = AppliedEffect("coulomb_friction", (1,), {"torque": [0.5]})
    draws = uniform(joint, width=0.0, about=0.7)
    std = entries(effect, draws, joint)["torque"]["std"]
    assert 1.96 * np.array(std) == pytest.approx([0.2])


def test_a_delay_is_uncertain_by_the_skew_of_sampling_too() -> None:
    delay = term("actuator_delay", 1)
    effect = AppliedEffect("actuator_delay", (1,), {"delay": [0.004]})
    out = entries(effect, uniform(delay, width=0.0, about=0.004), delay)
    assert out["delay"]["std"] == pytest.approx([2.5e-4])


def test_values_by_the_commands_are_added() -> None:
    rotor = term("armature", 2)
    effect = AppliedEffect("armature", (2,), {"inertia": [0.3]})
    by_commands = AppliedEffect("armature", (2,), {"inertia": [0.35]})
    out = entries(effect, uniform(rotor, width=0.1), rotor, instrumented=by_commands)
    assert out["inertia"]["by_commands"] == [0.35]


def test_what_was_scanned_has_the_deviation_of_the_scan() -> None:
    stribeck = term("stribeck_friction", 1)
    effect = AppliedEffect(
        "stribeck_friction", (1,), {"torque": [0.4], "velocity": [0.5]}
    )
    out = entries(
        effect,
        uniform(stribeck, width=0.1),
        stribeck,
        std=(0.03,),
        instrumented=effect,
    )
    assert out["velocity"]["std"] == [0.03] and "by_commands" not in out["velocity"]
    assert out["torque"]["by_commands"] == [0.4]
