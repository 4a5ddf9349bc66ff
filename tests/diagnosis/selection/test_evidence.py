"""Evidence for sets of terms: what they cost, how well they predict, and which values cannot be."""

from __future__ import annotations

import numpy as np
import pytest
from small_models import model, term
from synthetic import COULOMB, Truth

from gapscope.diagnosis.selection.visibility import visible
from gapscope.diagnosis.thresholds import NEW_EFFECT

STIFF = Truth(coulomb=(0.0, 3.0, 0.0))
NONE: frozenset = frozenset()


def test_an_effect_is_charged_once_and_each_parameter_by_the_samples():
    evidence, nominal = model(STIFF).evidence, model(STIFF)
    joints = [term(nominal, "coulomb_friction", j) for j in (1, 2)]
    per_parameter = 0.5 * np.log(evidence.scored.independent.sum())
    assert evidence.charge(NONE) == 0.0
    one = evidence.charge(frozenset(joints[:1]))
    two = evidence.charge(frozenset(joints))
    assert one == pytest.approx(per_parameter + NEW_EFFECT)
    assert two - one == pytest.approx(per_parameter)
    other = frozenset({joints[0], term(nominal, "viscous_friction", 1)})
    assert evidence.charge(other) == pytest.approx(2 * (per_parameter + NEW_EFFECT))


def test_the_true_term_raises_the_evidence_and_has_its_value():
    nominal = model(STIFF)
    true = term(nominal, "coulomb_friction", 2)
    fit = nominal.evidence.fit(frozenset({true}))
    assert fit.score > nominal.evidence.fit(NONE).score + NEW_EFFECT
    assert fit.theta[true.columns[0]] == pytest.approx(3.0, rel=0.05)
    assert not np.delete(fit.theta, true.columns).any()


def test_held_out_gap_of_the_true_term_falls_on_its_joint_alone():
    nominal = model(STIFF)
    true = frozenset({term(nominal, "coulomb_friction", 2)})
    before = nominal.evidence.held_out_mse(NONE).mean(axis=0)
    after = nominal.evidence.held_out_mse(true).mean(axis=0)
    assert after[1] < 0.1 * before[1]
    assert after[[0, 2]] == pytest.approx(before[[0, 2]], rel=0.2)


def test_errors_of_the_arm_explain_no_more_than_a_data_sheet_can_be_wrong_by():
    """A load of 1 % of the arm may be such an error, one that weighs more than the last link may not."""

    def left(mass: float) -> np.ndarray:
        evidence = model(Truth(mass=mass, com=(0.0, 0.0, 0.15))).evidence
        plain = evidence.held_out_mse(NONE, corrected=False).mean(axis=0)
        corrected = evidence.held_out_mse(NONE).mean(axis=0)
        likely = evidence.likely_mse(NONE).mean(axis=0)
        return (likely - corrected) / (plain - corrected)

    assert left(0.05) == pytest.approx(0.0, abs=1e-9)
    assert (left(5.0) > 0.1).all()


def test_a_term_of_nothing_lowers_the_evidence():
    nominal = model(STIFF)
    useless = frozenset({term(nominal, "torque_offset", 3)})
    assert nominal.evidence.fit(useless).score < nominal.evidence.fit(NONE).score


def test_friction_stops_where_nothing_is_left_of_what_the_data_sheet_states():
    slippery = Truth(coulomb=(0.0, -COULOMB[1] - 1.0, 0.0))
    nominal = model(slippery)
    friction = term(nominal, "coulomb_friction", 2)
    fit = nominal.evidence.fit(frozenset({friction}))
    assert fit.theta[friction.columns[0]] == -COULOMB[1]
    assert not fit.impossible
    assert fit.score > nominal.evidence.fit(NONE).score


def test_friction_below_zero_cannot_be_if_none_is_stated():
    nominal = model(Truth(stribeck=(0.0, -2.0, 0.0)))
    terms = frozenset({term(nominal, "stribeck_friction", 2)})
    fit = nominal.evidence.fit(terms)
    assert fit.impossible == terms
    assert fit.score == -np.inf


def test_a_payload_is_not_fitted_beside_a_change_of_the_last_link():
    nominal = model(STIFF)
    (payload,) = nominal.terms.of("payload")
    both = frozenset({payload, term(nominal, "link_inertia", 3)})
    assert payload in nominal.evidence.fit(both).impossible


@pytest.mark.parametrize(
    ("mass", "com", "possible"),
    [(-0.5, (0.0, 0.0, 0.15), True), (-1.0, (0.0, 0.0, 0.6), False)],
)
def test_a_payload_that_takes_more_inertia_than_the_last_link_has_cannot_be(
    mass: float, com: tuple[float, float, float], possible: bool
) -> None:
    """The fit finds the values; a simulator could gain energy from those of the second, so it may not name them."""
    nominal = model(Truth(mass=mass, com=com))
    (payload,) = nominal.terms.of("payload")
    fit = nominal.evidence.fit(frozenset({payload}))
    assert fit.theta[payload.columns[0]] == pytest.approx(mass, rel=0.1)
    assert fit.impossible == (frozenset() if possible else {payload})


def test_values_left_out_are_those_without_a_half_of_a_recording():
    nominal = model(STIFF)
    true = term(nominal, "coulomb_friction", 2)
    halves = nominal.evidence.left_out(frozenset({true}))
    values = [theta[true.columns[0]] for pair in halves for theta in pair]
    assert len(halves) == 3
    assert len(set(values)) == 6
    assert values == pytest.approx([3.0] * 6, rel=0.1)


def test_visible_is_what_closes_a_gap_that_a_person_could_see():
    nominal = model(STIFF)
    assert visible(nominal, frozenset({term(nominal, "coulomb_friction", 2)}))
    assert not visible(nominal, frozenset({term(nominal, "torque_offset", 3)}))
