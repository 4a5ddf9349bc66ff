"""Payload or changed last link: the same body is a payload, unless mass is missing."""

from __future__ import annotations

import numpy as np
import pytest
from small_models import model, selection, term
from synthetic import Truth

from gapscope.diagnosis.selection.fitted_model import Model, fit_terms
from gapscope.diagnosis.selection.load_or_link import prefer_payload

LOADED = Truth(mass=1.5, com=(0.1, 0.0, 0.05))


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
        model(LOADED), frozenset({term(model(LOADED), "link_inertia", 2)})
    )
    assert prefer_payload(other) is other


def test_the_search_names_a_load_a_payload() -> None:
    assert {t.effect for t in selection(LOADED).fit.terms} == {"payload"}
