"""The search on small cases: what is there, nothing more, and look-alikes compared."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from small_models import model, selection, term
from synthetic import Truth

from gapscope.diagnosis.model.linearisation import Linearisation
from gapscope.diagnosis.selection import fitted_model
from gapscope.diagnosis.selection.fitted_model import fit_terms
from gapscope.diagnosis.selection.near_equivalents import compare_near_equivalents
from gapscope.diagnosis.thresholds import RELINEARISATIONS

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
