"""The search on small cases: what is there, nothing more, and look-alikes compared."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import synthetic
from small_models import model, selection, term
from sweeps import nightly
from synthetic import Truth

from gapscope.diagnosis.model.linearisation import Linearisation
from gapscope.diagnosis.selection import fitted_model, search
from gapscope.diagnosis.selection.fitted_model import (
    Model,
    by_finding,
    by_term,
    clashes,
    consistent,
    fit_terms,
    near_equivalent,
    neighbours,
    nominal_model,
)
from gapscope.diagnosis.selection.questions import add_turned_base, prefer_payload
from gapscope.diagnosis.selection.search import add_pair, compare_near_equivalents
from gapscope.diagnosis.thresholds import RELINEARISATIONS
from gapscope.model.conditioning import condition, thinned
from gapscope.model.terms import Term, Terms

LATE = Truth(delay=(0.0, 0.012, 0.0))
LOADED = Truth(mass=1.5, com=(0.1, 0.0, 0.05))


def found(truth: Truth) -> set[tuple[str, int]]:
    return {(t.effect, t.joint) for t in selection(truth).fit.terms}


def test_a_healthy_arm_has_no_effect():
    result = selection(Truth())
    assert not result.fit.terms
    assert result.nominal_mse == pytest.approx(result.fit.held_out_mse)


def test_friction_is_found_on_its_joint_with_its_size():
    truth = Truth(coulomb=(0.0, 3.0, 0.0))
    result = selection(truth)
    assert found(truth) == {("coulomb_friction", 2)}
    (only,) = result.fit.terms
    assert result.fit.theta[only.columns[0]] == pytest.approx(3.0, rel=0.05)


def test_the_search_leaves_the_nominal_model_as_it_is():
    nominal = model(LOADED)
    theta = nominal.fit.theta.copy()
    fit_terms(nominal, frozenset(nominal.terms.of("payload")))
    assert np.array_equal(nominal.fit.theta, theta)
    assert not nominal.fit.terms


def test_a_delay_is_kept_and_the_lag_is_its_rival():
    nominal = model(LATE)
    lagging = fit_terms(nominal, frozenset({term(nominal, "actuator_lag", 2)}))
    kept, contested = compare_near_equivalents(lagging)
    assert {t.effect for t in kept.fit.terms} == {"actuator_delay"}
    assert contested[("actuator_delay", "actuator_lag")] < 0.0


def test_a_model_that_gains_too_little_is_not_linearised_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """If no linearisation is good enough, as many as allowed are made, unless the gain has to be impossibly high."""
    nominal = model(LOADED)
    load = frozenset(nominal.terms.of("payload"))
    made = []

    class Counted(Linearisation):
        def __init__(self, *arguments: Any) -> None:
            made.append(1)
            super().__init__(*arguments)

    monkeypatch.setattr(fitted_model, "Linearisation", Counted)
    monkeypatch.setattr(fitted_model, "LINEAR_ENOUGH", 0.0)
    fit_terms(nominal, load)
    assert len(made) == RELINEARISATIONS
    made.clear()
    fit_terms(nominal, load, least_gain=np.inf)
    assert len(made) == 1


# The search ends, whatever it tries.


def stub(*terms: str) -> Any:
    return SimpleNamespace(fit=SimpleNamespace(terms=frozenset(terms)))


def test_it_ends_when_refining_takes_out_again_what_a_pair_added(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Seen on a healthy arm against its reference: the same pair was added and taken out for ever."""
    start = stub()
    monkeypatch.setattr(search, "add_compliant_joint", lambda *_: None)
    monkeypatch.setattr(search, "add_pair", lambda *_: stub("load_friction"))
    monkeypatch.setattr(search, "add_groups", lambda *_: (start, ()))
    assert search.add_terms(start, lambda words: None) == (start, ())


# Pairs in the search: two effects in one move; none on a healthy arm, and none beside a compliant joint.


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


# An arm that hangs, or is mounted on a wall, is named as that: no linearisation reaches so far.


CUTOFF = 12.0


@pytest.mark.parametrize(
    ("roll", "pitch"),
    [
        (np.pi, 0.0),
        (-1.4, 0.0),
        *(
            nightly(*angles)
            for angles in ((3.0, 0.2), (0.1, 1.4), (2.35, 0.0), (-2.2, 0.7))
        ),
    ],
)
def test_its_angles_are_found(roll: float, pitch: float) -> None:
    nominal = _nominal(Truth(tilt=(roll, pitch)))
    turned = add_turned_base(nominal)
    (term,) = turned.fit.terms
    assert term.effect == "base_tilt"
    np.testing.assert_allclose(
        turned.fit.theta[list(term.columns)], [roll, pitch], atol=0.02
    )


@pytest.mark.parametrize(
    "truth",
    [
        nightly(Truth()),
        nightly(Truth(mass=3.0, com=(0.2, 0.0, 0.0))),
        Truth(tilt=(0.1, 0.1)),
    ],
)
def test_an_upright_arm_is_left_alone(truth: Truth) -> None:
    nominal = _nominal(truth)
    assert add_turned_base(nominal) is nominal


def _nominal(truth: Truth):  # type: ignore[no-untyped-def]
    folds = [
        [thinned(segment, 100.0) for segment in condition(recording, CUTOFF)]
        for recording in synthetic.recordings(truth, duration=6.0)[1:]
    ]
    return nominal_model(synthetic.arm(), synthetic.body(), folds, CUTOFF)


# Payload or changed last link: the same body is a payload, unless mass is missing.


def names(of: Model) -> set[str]:
    return {t.effect for t in of.fit.terms}


def as_link(truth: Truth, *others: tuple[str, int]) -> Model:
    """The model in which the last link is changed, and other terms are fitted."""
    nominal = model(truth)
    terms = {term(nominal, *other) for other in (("link_inertia", 3), *others)}
    return fit_terms(nominal, frozenset(terms))


def test_a_payload_takes_the_place_of_a_heavier_last_link() -> None:
    loaded = prefer_payload(as_link(LOADED))
    assert names(loaded) == {"payload"}
    (payload,) = loaded.terms.of("payload")
    mass, *moment = loaded.fit.theta[list(payload.columns)]
    assert mass == pytest.approx(1.5, rel=0.02)
    assert np.array(moment) / mass == pytest.approx([0.1, 0.0, 0.05], abs=0.005)


def test_it_does_beside_another_link_that_took_over_a_part() -> None:
    both = as_link(LOADED, ("link_inertia", 2))
    assert len(both.fit.terms) == 2
    assert "payload" in names(prefer_payload(both))


def test_a_lighter_last_link_stays_a_link() -> None:
    lighter = as_link(Truth(mass=-0.6, com=(0.05, 0.0, 0.0)))
    assert prefer_payload(lighter) is lighter


def test_a_model_without_the_last_link_stays_as_it_is() -> None:
    other = fit_terms(
        model(LOADED),
        frozenset({term(model(LOADED), "link_inertia", 2)}),
    )
    assert prefer_payload(other) is other


def test_the_search_names_a_load_a_payload() -> None:
    assert {t.effect for t in selection(LOADED).fit.terms} == {"payload"}


# Moves of the search, on an arm with three joints.


TERMS = Terms(3)


def move(effect: str, joint: int) -> Term:
    return next(t for t in TERMS.of(effect) if t.joint == joint)


ARMATURE, OFFSET = move("armature", 2), move("torque_offset", 3)
CHOSEN = frozenset({ARMATURE, OFFSET})


def test_each_term_can_be_removed() -> None:
    moves = neighbours(CHOSEN, TERMS)
    assert {ARMATURE} in moves and {OFFSET} in moves
    assert CHOSEN not in moves and len(set(moves)) == len(moves)


def test_a_term_is_swapped_on_its_joint_or_for_one_on_the_arm() -> None:
    moves = neighbours(CHOSEN, TERMS)
    assert {OFFSET, move("viscous_friction", 2)} in moves
    assert {OFFSET, move("viscous_friction", 1)} not in moves
    assert {OFFSET, move("base_tilt", 0)} in moves


def test_an_effect_is_renamed_on_all_its_joints_at_once() -> None:
    lags = frozenset({move("armature", 1), move("armature", 3)})
    renamed = {move("viscous_friction", 1), move("viscous_friction", 3)}
    assert renamed in neighbours(lags, TERMS)


def test_a_term_on_the_arm_is_swapped_for_a_changed_link() -> None:
    payload = move("payload", 0)
    moves = neighbours(frozenset({payload}), TERMS)
    assert all({move("link_inertia", joint)} in moves for joint in (1, 2, 3))


def test_a_compliant_joint_stays() -> None:
    soft = move("joint_elasticity", 1)
    moves = neighbours(frozenset({soft, OFFSET}), TERMS)
    assert moves and all(soft in move for move in moves)


def test_near_equivalents_are_no_moves_of_each_other() -> None:
    delay, lag = move("actuator_delay", 1), move("actuator_lag", 1)
    assert near_equivalent("actuator_delay") == "actuator_lag"
    assert near_equivalent("actuator_lag") == "actuator_delay"
    assert near_equivalent("armature") is None
    assert {lag} not in neighbours(frozenset({delay}), TERMS)
    assert {move("armature", 1)} in neighbours(frozenset({delay}), TERMS)


def test_a_term_clashes_with_itself_and_its_near_equivalent_on_the_same_joint() -> None:
    delay = frozenset({move("actuator_delay", 1)})
    assert clashes(move("actuator_delay", 1), delay)
    assert clashes(move("actuator_lag", 1), delay)
    assert not clashes(move("actuator_lag", 2), delay)
    assert consistent(delay | {move("actuator_lag", 2)})
    assert not consistent(delay | {move("actuator_lag", 1)})


def test_terms_are_grouped_by_finding_links_apart() -> None:
    links = {move("link_inertia", 1), move("link_inertia", 2)}
    joints = {move("armature", 1), move("armature", 2)}
    chosen = frozenset(links | joints)
    assert sorted(map(len, by_finding(chosen))) == [1, 1, 2]
    assert frozenset(joints) in by_finding(chosen)
    assert by_term(frozenset(joints)) == [
        {t} for t in sorted(joints, key=lambda t: t.joint)
    ]
