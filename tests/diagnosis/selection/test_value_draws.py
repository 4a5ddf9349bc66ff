"""Intervals of fitted values: they widen with what the nominal arm has wrong, and with what recordings disagree on."""

from __future__ import annotations

import numpy as np
import synthetic
from small_models import model, term
from synthetic import Truth

from gapscope.diagnosis.selection.fitted_model import Model, fit_terms, nominal_model
from gapscope.diagnosis.selection.value_draws import value_draws
from gapscope.model.conditioning import TORQUE_CUTOFF, condition, thinned
from gapscope.model.terms import Term

LOAD = {"mass": 1.5, "com": (0.1, 0.0, 0.05)}


def draws(nominal: Model, *terms: Term) -> np.ndarray:
    """Draws of the values of some terms alone, (D, P)."""
    fitted = fit_terms(nominal, frozenset(terms))
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
    folds = [[thinned(s, 100.0) for s in condition(r, 25.0)] for r in recordings]
    nominal = nominal_model(synthetic.arm(), synthetic.body(), folds, TORQUE_CUTOFF)
    dry = term(nominal, "coulomb_friction", 2)
    return half_width(draws(nominal, dry)[:, dry.columns[0]])


def test_intervals_widen_if_recordings_disagree() -> None:
    assert friction(1.6) > 2.0 * friction(1.0)


def test_the_same_seed_gives_the_same_draws() -> None:
    nominal = model(Truth(coulomb=(0.0, 1.0, 0.0)))
    dry = term(nominal, "coulomb_friction", 2)
    assert np.array_equal(draws(nominal, dry), draws(nominal, dry))


def test_values_of_other_terms_are_zero() -> None:
    nominal = model(Truth(coulomb=(0.0, 1.0, 0.0)))
    dry = term(nominal, "coulomb_friction", 2)
    others = np.delete(draws(nominal, dry), dry.columns, axis=1)
    assert not others.any()
