"""Pairs in the search: two effects in one move; none on a healthy arm, and none beside a compliant joint."""

from __future__ import annotations

from dataclasses import replace

from small_models import model
from synthetic import Truth

from gapscope.diagnosis.selection.search import add_pair


def test_both_effects_come_in_one_move() -> None:
    nominal = model(Truth(armature=(0.0, 0.4, 0.0), offset=(0.0, 0.0, 1.5)))
    messages: list[str] = []
    found = add_pair(nominal, messages.append)
    assert found is not None and not nominal.fit.terms
    assert {(t.effect, t.joint) for t in found.fit.terms} == {
        ("armature", 2),
        ("torque_offset", 3),
    }
    assert len(messages) == 1
    assert "armature" in messages[0] and "torque_offset" in messages[0]


def test_a_healthy_arm_has_none() -> None:
    assert add_pair(model(Truth()), lambda message: None) is None


def test_none_is_looked_for_beside_a_compliant_joint() -> None:
    nominal = model(Truth(armature=(0.0, 0.4, 0.0), offset=(0.0, 0.0, 1.5)))
    soft = next(t for t in nominal.terms.of("joint_elasticity") if t.joint == 1)
    compliant = replace(nominal, fit=nominal.evidence.fit(frozenset({soft})))
    assert add_pair(compliant, lambda message: None) is None
