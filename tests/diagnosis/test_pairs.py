"""Pairs in the search: two effects in one move; none on a healthy arm, and none beside a joint that rings."""

from __future__ import annotations

import synthetic
from synthetic import Truth

from gapscope.diagnosis.selection.search import _pair
from gapscope.diagnosis.selection.state import State
from gapscope.ident.signals.conditioning import (
    TORQUE_CUTOFF,
    condition,
    position_cutoff,
    thinned,
)


def state(truth: Truth) -> State:
    case = synthetic.case(truth, seed=5)
    cutoff = position_cutoff(case.recordings)
    folds = [[thinned(s, 100.0) for s in condition(r, cutoff)] for r in case.recordings]
    return State(synthetic.arm(), synthetic.body(), folds, min(TORQUE_CUTOFF, cutoff))


def test_both_effects_come_in_one_move() -> None:
    of, told = (
        state(Truth(armature=(0.0, 0.4, 0.0), offset=(0.0, 0.0, 1.5))),
        list[str](),
    )
    assert _pair(of, told.append)
    assert {(t.effect, t.joint) for t in of.fit.terms} == {
        ("armature", 2),
        ("torque_offset", 3),
    }
    assert len(told) == 1 and "armature" in told[0] and "torque_offset" in told[0]


def test_a_healthy_arm_has_none_and_stays_as_it_was() -> None:
    of = state(Truth())
    before = of.model
    assert not _pair(of, lambda message: None)
    assert of.model is before


def test_none_is_looked_for_beside_a_joint_that_rings() -> None:
    of = state(Truth(armature=(0.0, 0.4, 0.0), offset=(0.0, 0.0, 1.5)))
    soft = next(t for t in of.terms.of("joint_elasticity") if t.joint == 1)
    of.model = of.model._replace(fit=of.evidence.fit(frozenset({soft})))
    assert not _pair(of, lambda message: None)
