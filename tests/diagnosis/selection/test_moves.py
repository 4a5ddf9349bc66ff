"""Moves of the search, on an arm with three joints."""

from __future__ import annotations

from gapscope.diagnosis.selection.moves import (
    by_finding,
    by_term,
    clashes,
    consistent,
    near_equivalent,
    neighbours,
)
from gapscope.model.terms import Term, Terms

TERMS = Terms(3)


def term(effect: str, joint: int) -> Term:
    return next(t for t in TERMS.of(effect) if t.joint == joint)


ARMATURE, OFFSET = term("armature", 2), term("torque_offset", 3)
CHOSEN = frozenset({ARMATURE, OFFSET})


def test_each_term_can_be_removed() -> None:
    moves = neighbours(CHOSEN, TERMS)
    assert {ARMATURE} in moves and {OFFSET} in moves
    assert CHOSEN not in moves and len(set(moves)) == len(moves)


def test_a_term_is_swapped_on_its_joint_or_for_one_on_the_arm() -> None:
    moves = neighbours(CHOSEN, TERMS)
    assert {OFFSET, term("viscous_friction", 2)} in moves
    assert {OFFSET, term("viscous_friction", 1)} not in moves
    assert {OFFSET, term("base_tilt", 0)} in moves


def test_an_effect_is_renamed_on_all_its_joints_at_once() -> None:
    lags = frozenset({term("armature", 1), term("armature", 3)})
    renamed = {term("viscous_friction", 1), term("viscous_friction", 3)}
    assert renamed in neighbours(lags, TERMS)


def test_a_term_on_the_arm_is_swapped_for_a_changed_link() -> None:
    payload = term("payload", 0)
    moves = neighbours(frozenset({payload}), TERMS)
    assert all({term("link_inertia", joint)} in moves for joint in (1, 2, 3))


def test_a_compliant_joint_stays() -> None:
    soft = term("joint_elasticity", 1)
    moves = neighbours(frozenset({soft, OFFSET}), TERMS)
    assert moves and all(soft in move for move in moves)


def test_near_equivalents_are_no_moves_of_each_other() -> None:
    delay, lag = term("actuator_delay", 1), term("actuator_lag", 1)
    assert near_equivalent("actuator_delay") == "actuator_lag"
    assert near_equivalent("actuator_lag") == "actuator_delay"
    assert near_equivalent("armature") is None
    assert {lag} not in neighbours(frozenset({delay}), TERMS)
    assert {term("armature", 1)} in neighbours(frozenset({delay}), TERMS)


def test_a_term_clashes_with_itself_and_its_near_equivalent_on_the_same_joint() -> None:
    delay = frozenset({term("actuator_delay", 1)})
    assert clashes(term("actuator_delay", 1), delay)
    assert clashes(term("actuator_lag", 1), delay)
    assert not clashes(term("actuator_lag", 2), delay)
    assert consistent(delay | {term("actuator_lag", 2)})
    assert not consistent(delay | {term("actuator_lag", 1)})


def test_terms_are_grouped_by_finding_links_apart() -> None:
    links = {term("link_inertia", 1), term("link_inertia", 2)}
    joints = {term("armature", 1), term("armature", 2)}
    chosen = frozenset(links | joints)
    assert sorted(map(len, by_finding(chosen))) == [1, 1, 2]
    assert frozenset(joints) in by_finding(chosen)
    assert by_term(frozenset(joints)) == [
        {t} for t in sorted(joints, key=lambda t: t.joint)
    ]
