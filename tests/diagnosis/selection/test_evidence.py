"""Evidence for sets of terms: what they cost, how well they predict, and which values cannot be."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic
from small_models import model, term
from synthetic import COULOMB, Truth

from gapscope.diagnosis.model.fit_data import Discrepancy, EquationRows, Fold
from gapscope.diagnosis.model.normal_equations import NormalEquations, with_skew
from gapscope.diagnosis.selection.evidence import FoldEquations, value_draws
from gapscope.diagnosis.selection.fitted_model import (
    Model,
    fitted_about,
    nominal_model,
)
from gapscope.model.conditioning import TORQUE_CUTOFF, condition
from gapscope.model.terms import Term, Terms

STIFF = Truth(coulomb=(0.0, 3.0, 0.0))
NONE: frozenset = frozenset()


def test_the_true_term_raises_the_evidence_and_has_its_value():
    nominal = model(STIFF)
    true = term(nominal, "coulomb_friction", 2)
    fit = nominal.evidence.fit(frozenset({true}))
    assert fit.score > nominal.evidence.fit(NONE).score
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
        likely = evidence.mse_plausible_inertials(NONE).mean(axis=0)
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
    assert not fit.infeasible
    assert fit.score > nominal.evidence.fit(NONE).score


def test_friction_below_zero_cannot_be_if_none_is_stated():
    case = synthetic.case(Truth(stribeck=(0.0, -2.0, 0.0)), seed=5)
    dry = Terms(3).of("stribeck_friction")[1]
    folds = [condition(recording, 25.0) for recording in case.recordings]
    nominal = nominal_model(
        case.arm, synthetic.body(), folds, TORQUE_CUTOFF, {dry: (0.2,)}
    )
    terms = frozenset({dry})
    fit = nominal.evidence.fit(terms)
    assert fit.infeasible == terms
    assert fit.score == -np.inf


def test_a_payload_is_not_fitted_beside_a_change_of_the_last_link():
    nominal = model(STIFF)
    payload = term(nominal, "payload", 0)
    both = frozenset({payload, term(nominal, "link_inertia", 3)})
    assert payload in nominal.evidence.fit(both).infeasible


@pytest.mark.parametrize(
    ("mass", "com", "possible"),
    [(-0.5, (0.0, 0.0, 0.15), True), (-1.0, (0.0, 0.0, 0.6), False)],
)
def test_a_payload_that_takes_more_inertia_than_the_last_link_has_cannot_be(
    mass: float, com: tuple[float, float, float], possible: bool
) -> None:
    """The fit finds the values; a simulator could gain energy from those of the second, so it may not name them."""
    nominal = model(Truth(mass=mass, com=com))
    payload = term(nominal, "payload", 0)
    fit = nominal.evidence.fit(frozenset({payload}))
    assert fit.theta[payload.columns[0]] == pytest.approx(mass, rel=0.1)
    assert fit.infeasible == (frozenset() if possible else {payload})


def test_values_left_out_are_those_without_a_half_of_a_recording():
    nominal = model(STIFF)
    true = term(nominal, "coulomb_friction", 2)
    halves = nominal.evidence.left_out(frozenset({true}))
    values = [theta[true.columns[0]] for pair in halves for theta in pair]
    assert len(halves) == 3
    assert len(set(values)) == 6
    assert values == pytest.approx([3.0] * 6, rel=0.1)


# Equations of folds at a skew, and mean squares of what is left of each fold, by hand.


A, N = np.array([1.0, 2.0, 0.0, 1.0]), np.array([0.0, 1.0, 1.0, 0.0])
HEALTHY = Discrepancy(np.array([0.36]), np.array([2.0]))
Y, D = np.array([3.0, 5.0, 1.0, 2.0]), np.array([1.0, 0.0, 2.0, 1.0])


def gram(*columns: np.ndarray) -> np.ndarray:
    x = np.stack(columns, axis=1)
    return x.T @ x


def fold(y: np.ndarray) -> Fold:
    """Four rows of one joint with one term and one inertial, whose floor is 0.5 N m."""
    flat = np.zeros((4, 1))
    rows = EquationRows(
        terms=A[:, None, None],
        inertials=N[:, None, None],
        others=np.zeros((4, 1, 0)),
        y=y[:, None],
        rate=D[:, None],
        sticking=flat,
        steady2=flat + 0.25,
        known=flat + 1.0,
    )
    return Fold(rows, 2)


def test_a_skew_takes_its_share_of_the_rate_from_the_gap() -> None:
    np.testing.assert_allclose(
        with_skew(gram(A, N, Y, D), 0.25), gram(A, N, Y - 0.25 * D)
    )
    np.testing.assert_allclose(with_skew(gram(A, N, Y, D), 0.0), gram(A, N, Y))


def test_rows_are_summed_and_floors_squared() -> None:
    equations = FoldEquations([fold(Y), fold(2 * Y)], HEALTHY)
    np.testing.assert_allclose(equations.gram[0, 0], gram(A, N, Y, D))
    np.testing.assert_allclose(equations.gram[1, 0], gram(A, N, 2 * Y, D))
    assert equations.count.tolist() == [[4.0], [4.0]]
    assert equations.floor2.tolist() == [[0.25], [0.25]]


def test_rows_count_by_the_discrepancy_and_it_is_what_is_expected_to_be_left() -> None:
    """Two rows count as one sample; a mean square of 0.36 is left where noise explains 0.25."""
    equations = FoldEquations([fold(Y)], HEALTHY)
    assert equations.independent.tolist() == [[2.0]]
    assert equations.expected2.tolist() == [[0.36]]


def test_equations_at_a_skew_are_those_of_the_gap_without_it() -> None:
    equations = FoldEquations([fold(Y)], HEALTHY)
    once, twice = np.ones((1, 1)), np.full((1, 1), 2.0)
    expected = gram(A, N, Y - 0.25 * D)
    np.testing.assert_allclose(equations.weighed(once)[0], gram(A, N, Y))
    np.testing.assert_allclose(equations.at(0.25).weighed(once)[0], expected)
    np.testing.assert_allclose(equations.at(0.25).weighed(twice)[0], 2 * expected)


def test_a_fold_is_predicted_with_the_values_of_its_own_equations() -> None:
    """y = 2 A on one fold, 3 A on the other; each predicted with the other's value leaves |A|^2 = 6 over 4 rows."""
    equations = FoldEquations([fold(2 * A), fold(3 * A)], HEALTHY)
    by_fold = equations.weighed(np.ones((2, 1)))
    own = NormalEquations(by_fold, 1, np.array([[1e12]]))
    others = NormalEquations(by_fold[::-1], 1, np.array([[1e12]]))
    columns = np.array([0])
    exchanged = equations.mean_square(others, columns, corrected=False)
    kept = equations.mean_square(own, columns, corrected=False)
    assert exchanged[:, 0] == pytest.approx([1.5, 1.5], abs=1e-5)
    assert kept[:, 0] == pytest.approx([0.0, 0.0], abs=1e-5)


# Intervals of fitted values: they widen with what the nominal arm has wrong, and with what recordings disagree on.


LOAD = {"mass": 1.5, "com": (0.1, 0.0, 0.05)}


def draws(nominal: Model, *terms: Term) -> np.ndarray:
    """Draws of the values of some terms alone, (D, P)."""
    theta = nominal.evidence.fit(frozenset(terms)).theta
    fitted = fitted_about(nominal, {one: theta[list(one.columns)] for one in terms})
    return value_draws(fitted.evidence, fitted.fit.terms, np.random.default_rng(1))


def mass(nominal: Model, *others: Term) -> np.ndarray:
    """Draws of the mass of a payload, (D,)."""
    load = term(nominal, "payload", 0)
    return draws(nominal, load, *others)[:, load.columns[0]]


def half_width(values: np.ndarray) -> float:
    low, high = np.quantile(values, [0.025, 0.975])
    return float(high - low) / 2


def test_a_load_is_less_certain_on_an_arm_whose_links_are_off() -> None:
    right = mass(model(Truth(**LOAD)))
    wrong = mass(model(Truth(**LOAD, link=2, link_mass=0.4, link_com=(0.0, 0.0, 0.02))))
    assert half_width(wrong) > 1.5 * half_width(right)
    for values in (right, wrong):
        assert abs(np.median(values) - 1.5) < half_width(values)


def test_a_link_that_was_named_is_drawn_from_and_widens_the_load() -> None:
    truth = Truth(**LOAD, link=2, link_mass=0.2)
    nominal = model(truth)
    link = term(nominal, "link_inertia", 2)
    values = draws(nominal, term(nominal, "payload", 0), link)[:, link.columns[0]]
    # the link's own change is that beside which it was named
    assert abs(np.median(values) - 0.2) < half_width(values)


def friction(second: float) -> float:
    """Half width of the Coulomb friction of joint 2, 1 N m larger in two recordings and ``second`` in the third."""
    recordings = [
        *synthetic.recordings(Truth(coulomb=(0.0, 1.0, 0.0)))[:2],
        synthetic.recordings(Truth(coulomb=(0.0, second, 0.0)))[2],
    ]
    folds = [condition(recording, 25.0) for recording in recordings]
    nominal = nominal_model(synthetic.arm(), synthetic.body(), folds, TORQUE_CUTOFF, {})
    dry = term(nominal, "coulomb_friction", 2)
    return half_width(draws(nominal, dry)[:, dry.columns[0]])


def test_intervals_widen_if_recordings_disagree() -> None:
    assert friction(1.6) > 1.4 * friction(1.0)


def test_the_same_seed_gives_the_same_draws() -> None:
    nominal = model(Truth(coulomb=(0.0, 1.0, 0.0)))
    dry = term(nominal, "coulomb_friction", 2)
    assert np.array_equal(draws(nominal, dry), draws(nominal, dry))


def test_values_of_other_terms_are_zero() -> None:
    nominal = model(Truth(coulomb=(0.0, 1.0, 0.0)))
    dry = term(nominal, "coulomb_friction", 2)
    others = np.delete(draws(nominal, dry), dry.columns, axis=1)
    assert not others.any()
